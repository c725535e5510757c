"""Files that hold recordings: folders of CSV, MCAP, ROS bags, KUKA traces. Each reader returns a `Recording`."""
