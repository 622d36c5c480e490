"""ROS 1 and ROS 2 bags and MCAP files: rosbags opens them, a decoder of our own reads their messages."""
