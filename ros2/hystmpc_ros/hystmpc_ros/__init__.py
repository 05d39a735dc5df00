"""The planner of hystmpc as a ROS 2 node."""
