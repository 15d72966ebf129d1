"""The web viewer: shows a robot's topics in a page; its goals, pulls and buttons are topics and services."""
