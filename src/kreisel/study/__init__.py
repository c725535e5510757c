"""Monte-Carlo studies of calibrations in the virtual cell: whether they are as good as they say."""
