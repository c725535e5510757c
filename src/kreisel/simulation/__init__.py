"""The virtual cell: simulated motion, readings and poses, with the true values of all parameters."""
