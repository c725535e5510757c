"""What a recording shows while it is made: estimates, signals, the arm. It reads the file and owns nothing."""
