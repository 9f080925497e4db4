"""The Dynamixel bus: control table, the bus over `dynamixel_sdk`, and the loop that drives an arm with it."""
