"""Live page of a recording: estimates, signals, the arm. It only reads the recording's file."""
