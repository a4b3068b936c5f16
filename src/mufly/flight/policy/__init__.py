"""Learned policies: file, evaluation, and flight in place of the control law.

:mod:`mufly.flight.policy.observation` defines what a policy observes and commands,
:mod:`mufly.flight.policy.policy_file` its file, :mod:`mufly.flight.policy.policy_network` the network, and
:mod:`mufly.flight.policy.policy_controllers` how it flies.
"""

from mufly.flight.policy.policy_controllers import PolicyControlLaw, PolicyControllers, check_policy_fits_vehicle
from mufly.flight.policy.policy_file import load_policy, save_policy
from mufly.flight.policy.policy_network import LearnedPolicy, PolicyLayer

__all__ = [
    "LearnedPolicy",
    "PolicyControlLaw",
    "PolicyControllers",
    "PolicyLayer",
    "check_policy_fits_vehicle",
    "load_policy",
    "save_policy",
]
