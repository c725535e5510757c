"""Parts of the compiled library, called one by one. The package needs none of these calls."""
