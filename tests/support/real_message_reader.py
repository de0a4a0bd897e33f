# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reads messages with the classes of installed packages; run as a program, with the foreign packages on its path.

Its standard input is JSON: the CDR of a message as hexadecimal digits, by its type. It prints as JSON each message
by its type: nested lists of the values of its fields, numbers as floats.
"""

import json
import sys
from array import array
from importlib import import_module
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message


def flatten(value: Any) -> Any:
    if isinstance(value, (bytes, bytearray, array, list, tuple, np.ndarray)):
        return [flatten(v) for v in value]
    if isinstance(value, (bool, int, float, np.generic)):
        return float(value)
    if isinstance(value, str):
        return value
    return [flatten(getattr(value, name)) for name in value.get_fields_and_field_types()]


found = {}
for msgtype, digits in json.load(sys.stdin).items():
    module, _, name = msgtype.rpartition('/')
    message_class = getattr(import_module(module.replace('/', '.')), name)
    found[msgtype] = flatten(deserialize_message(bytes.fromhex(digits), message_class))
print(json.dumps(found))
