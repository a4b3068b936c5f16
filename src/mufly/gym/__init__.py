"""Gymnasium environments: learning to hover, to follow waypoints, to avoid columns and to land.

``import mufly.gym`` registers ``mufly/Hover-v0``, ``mufly/Waypoint-v0``, ``mufly/Obstacle-v0`` and ``mufly/Land-v0``.
Gymnasium also finds the environments of an installed mufly by itself. :mod:`mufly.gym.vector_env` describes the
options, :mod:`mufly.flight.policy.observation` what a learner observes and commands, :mod:`mufly.gym.tasks` the
rewards.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mufly.errors import MuflyError

if TYPE_CHECKING:
    from mufly.gym.vector_env import MuflyEnv, MuflyVectorEnv

__all__ = ["ENVIRONMENT_IDS", "MuflyEnv", "MuflyVectorEnv", "register_environments"]

ENVIRONMENT_IDS = {
    "mufly/Hover-v0": "hover",
    "mufly/Waypoint-v0": "waypoint",
    "mufly/Obstacle-v0": "obstacle",
    "mufly/Land-v0": "land",
}
"""Identifier of each environment, and its task."""


def register_environments() -> None:
    """Register all environments with Gymnasium; also the entry point of Gymnasium's plug-ins."""
    from gymnasium.envs.registration import register, registry

    for name, task in ENVIRONMENT_IDS.items():
        if name not in registry:
            register(
                id=name,
                entry_point="mufly.gym.vector_env:MuflyEnv",
                vector_entry_point="mufly.gym.vector_env:MuflyVectorEnv",
                kwargs={"task": task},
            )


try:
    register_environments()
except ImportError:
    raise MuflyError("Gymnasium is not installed; run: pip install 'mufly[gym]'") from None


def __getattr__(name: str) -> Any:
    if name in ("MuflyEnv", "MuflyVectorEnv"):
        from mufly.gym import vector_env

        return getattr(vector_env, name)
    raise AttributeError(f"module 'mufly.gym' has no attribute {name!r}")
