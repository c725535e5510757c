"""Checks of recordings: what is repaired, left out and counted, warned of, or refused."""
