"""The ROS 2 nodes, and the only importers of rclpy: parameters in, messages out, one call between."""

import os

# before numpy is imported: threads for matrices of a hundred unknowns only wait for each other, and for the driver's cycles
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
