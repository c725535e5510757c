"""Groups of parameters in the words of data sheets."""

TITLES = {
    "gyro_offset": "Gyro bias",
    "gyro_polynomial": "Gyro non-linearity",
    "gyro_g_sensitivity": "Gyro g-sensitivity",
    "gyro_g_squared": "Gyro g²-sensitivity",
    "gyro_asymmetry": "Gyro scale-factor asymmetry",
    "gyro_cubic": "Gyro cubic non-linearity",
    "gyro_axis_delay": "Delay of a gyro axis",
    "gyro_axis_smoothing": "Smoothing of a gyro axis",
    "gyro_temperature": "Gyro bias by temperature",
    "gyro_scale_temperature": "Gyro scale factor by temperature",
    "accel_offset": "Accelerometer bias",
    "accel_polynomial": "Accelerometer non-linearity",
    "accel_asymmetry": "Accelerometer scale-factor asymmetry",
    "accel_cubic": "Accelerometer cubic non-linearity",
    "accel_delay": "Delay of the accelerometers",
    "accel_smoothing": "Smoothing of the accelerometers",
    "accel_axis_delay": "Delay of an accelerometer axis",
    "accel_axis_smoothing": "Smoothing of an accelerometer axis",
    "accel_temperature": "Accelerometer bias by temperature",
    "accel_scale_temperature": "Accelerometer scale factor by temperature",
    "lever_arms": "Position of accelerometer",
    "alignment": "Tilt of the reference frame",
    "north": "Direction of north",
    "earth_down": "Latitude",
    "gravity": "Gravity",
    "time_offset": "Time offset of the reference",
    "time_skew": "Ratio of the clocks",
    "position_scale": "Scale of the reference's positions",
    "position_heading": "Heading of the positions' frame",
    "reference_smoothing": "Smoothing of the reference's poses",
    "mount_bending": "Bending of the mount",
    "mount_deflection": "Deflection of the mount",
    "robot_placement": "Placement of robot joint",
    "robot_gears": "Gear of robot joint",
    "robot_compliance": "Sag of robot joint",
    "robot_zeros": "Zero of robot joint",
}
"""Of groups of parameters, in the singular."""

SENSORS = {"gyro_cross_coupling": "Gyro", "accel_cross_coupling": "Accelerometer"}
"""Of the groups that are matrices."""
