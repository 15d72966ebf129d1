"""`softsim topics`: list live topics, print their messages, measure their rates; works without ros2cli."""

from __future__ import annotations

import argparse

from softsim_ros.cli import add_number, table_lines

OF_ROS = ("/parameter_events", "/rosout")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--echo", metavar="TOPIC", help="print the messages of a topic until Ctrl-C")
    what.add_argument("--hz", metavar="TOPIC", help="measure the rate of a topic until Ctrl-C")
    add_number(parser, "--count", int, "N", "end after N messages (with --hz: N reports)")
    parser.add_argument("--full", action="store_true", help="with --echo: print long arrays whole")
    parser.add_argument("--all", action="store_true", help="list ROS's own topics, too")
    add_number(parser, "--wait", 10.0, "S", "longest wait for a topic (10 s)")


def run(arguments: argparse.Namespace) -> int:
    """List topics, print messages, or measure a rate."""
    from softsim_ros.cli.graph import graph

    with graph.observer() as observer:
        if arguments.echo or arguments.hz:
            return graph.follow(
                observer,
                arguments.echo or arguments.hz,
                show=bool(arguments.echo),
                count=arguments.count,
                limit=None if arguments.full else 12,
                wait_s=arguments.wait,
            )
        rows = graph.topic_rows(  # without --all, not ROS's own and those hidden by its convention
            observer, lambda name: arguments.all or not (name in OF_ROS or "/_" in name)
        )
    if not rows:
        print(f"no topics: no node runs in {graph.where()}; start one with: softsim up tripod")
        return 0
    lines = [("topic", "type", "publishers", "subscribers"), *(tuple(map(str, row)) for row in rows)]
    print("\n".join(table_lines(lines)))
    return 0
