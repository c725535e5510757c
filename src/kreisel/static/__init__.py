"""Calibration without a reference: standstills in many attitudes, gravity and the turns between them."""
