"""Recording of topics to rosbag2 files (MCAP), and what is made from them: replays, exports, reports."""
