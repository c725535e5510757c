"""State layouts on manifolds, sigma points and the square-root filter that uses them."""
