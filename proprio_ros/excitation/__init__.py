"""Probes: which joint is pushed how, from where, and the state machine that runs them. No clock, no ROS."""
