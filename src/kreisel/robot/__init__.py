"""Robot arms: their kinematics, and motions suitable for a calibration.

Needs pinocchio and ruckig, which `pip install kreisel[robot]` brings.
"""
