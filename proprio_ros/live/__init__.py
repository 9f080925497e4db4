"""What the identifier does without ROS: a recording as it happens, the folder it goes to, the online estimator, payload export."""
