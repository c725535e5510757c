"""Inverse filtering: readings predicted from a smooth motion."""
