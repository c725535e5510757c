"""Robot arms: their kinematics, and motions suitable for a calibration."""
