from . import policy_node as policy_node
from .policy_node import (
    Heard as Heard,
    PolicyNode as PolicyNode,
)
