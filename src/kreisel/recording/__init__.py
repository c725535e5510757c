"""The recording: its type, its settings, and the checks of its streams."""
