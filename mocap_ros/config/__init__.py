# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The configuration: every parameter with its default, access by name, and parameter files."""

from mocap_ros.config.access import (
    Parameter,
    format_value,
    parameters,
    parse_numbers,
    settings,
    suggest_parameter,
    values,
    with_settings,
    with_values,
)
from mocap_ros.config.defaults import (
    ClassifierConfig,
    Config,
    KeyframesConfig,
    NodeConfig,
    RecorderConfig,
    SolverConfig,
    TrackerConfig,
    Value,
)
from mocap_ros.config.yaml_file import from_yaml, load_yaml, to_yaml

__all__ = [
    'ClassifierConfig',
    'Config',
    'KeyframesConfig',
    'NodeConfig',
    'Parameter',
    'RecorderConfig',
    'SolverConfig',
    'TrackerConfig',
    'Value',
    'format_value',
    'from_yaml',
    'load_yaml',
    'parameters',
    'parse_numbers',
    'settings',
    'suggest_parameter',
    'to_yaml',
    'values',
    'with_settings',
    'with_values',
]
