"""Quality of service as bags keep it, from and to rclpy's."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

FAST_DEPTH = 100
"""A replay may be faster than the publisher was; so many messages may wait for a slow listener."""


def bag_qos(profile: QoSProfile) -> Qos:
    """The profile a publisher offers, as a bag keeps it."""
    return Qos(
        QosHistory[profile.history.name],
        profile.depth,
        QosReliability[profile.reliability.name],
        QosDurability[profile.durability.name],
        _bag_time(profile.deadline),
        _bag_time(profile.lifespan),
        QosLiveliness[profile.liveliness.name],
        _bag_time(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )


def publisher_qos(offered: Qos | None) -> QoSProfile:
    """The profile with which a recorded topic is published again; reliable where the bag says nothing."""
    if offered is None:
        return QoSProfile(depth=10)
    best_effort = offered.reliability is QosReliability.BEST_EFFORT
    latched = offered.durability is QosDurability.TRANSIENT_LOCAL
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(offered.depth, 1) if latched else max(offered.depth, FAST_DEPTH),
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _bag_time(duration: Duration) -> QosTime:
    return QosTime(*divmod(duration.nanoseconds, 1_000_000_000))
