from . import observer_node as observer_node
from .observer_node import ObserverNode as ObserverNode
