"""What every ROS process of the suite shares: its environment, its parameters, its start and its end."""
