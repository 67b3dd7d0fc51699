"""Forecasts frame by frame, over a recording or live, without ROS."""
