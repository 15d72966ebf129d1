"""A robot seen through its topics and services, without any user interface.

`robot_client.RobotClient` composes one part for each peer: joints, simulator, bridge, inverse control, closed
loop. Terminal, page, demos and scripts of users hold one; `robot_client.connect` gives a script one that it
can wait with. `state` is pure.
"""
