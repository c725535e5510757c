"""The command line. Each command has its own module and imports what it needs when it runs."""
