"""Bags: MCAP files of runs, written for ROS tools, and read without trusting their content."""
