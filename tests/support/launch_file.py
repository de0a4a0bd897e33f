# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The launch file without the packages that `ros2 launch` needs, none of which comes as a wheel."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from tests.support.modules import load_module
from tests.support.paths import ROOT


class Recorded(SimpleNamespace):
    """What a class of `launch` was created with; it substitutes for all of them."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(args=args, **options)

    def perform(self, context: dict[str, str]) -> str:
        """Return the value of a launch argument."""
        return context[self.args[0]]


def load_launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the launch file, with substitutes for the packages that it imports."""
    classes = {
        'launch': ('LaunchContext', 'LaunchDescription'),
        'launch.actions': ('DeclareLaunchArgument', 'OpaqueFunction'),
        'launch.conditions': ('IfCondition',),
        'launch.substitutions': ('LaunchConfiguration', 'PathJoinSubstitution'),
        'launch_ros': (),
        'launch_ros.actions': ('Node',),
        'launch_ros.parameter_descriptions': ('ParameterValue',),
        'launch_ros.substitutions': ('FindPackageShare',),
    }
    for name, members in classes.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, Recorded)
        monkeypatch.setitem(sys.modules, name, module)
    return load_module(ROOT / 'config' / 'launch' / 'mocap.launch.py')
