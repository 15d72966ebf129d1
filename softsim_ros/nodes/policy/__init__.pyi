from . import policy_node as policy_node
from .policy_node import (
    LatestReadings as LatestReadings,
    PolicyNode as PolicyNode,
)
