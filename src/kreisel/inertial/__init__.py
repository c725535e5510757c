"""What an inertial measurement unit measures on the rotating Earth, and its readings integrated to motion."""
