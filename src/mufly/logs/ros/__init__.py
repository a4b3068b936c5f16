"""ROS 2 messages: the table of topics, and bags."""
