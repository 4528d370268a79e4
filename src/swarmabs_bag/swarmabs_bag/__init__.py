"""Bags: the MCAP file of a run, written so that ROS tools open it, and read with nothing taken on trust."""
