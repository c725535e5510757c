"""What an inertial measurement unit feels on the rotating Earth, and how its readings become motion."""
