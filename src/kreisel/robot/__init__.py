"""Robot arms: their kinematics, and the motions that suit a calibration.

Needs pinocchio and ruckig, which `pip install kreisel[robot]` brings.
"""
