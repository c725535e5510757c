"""Fits of a problem: what every estimator gives, and what is done with it."""
