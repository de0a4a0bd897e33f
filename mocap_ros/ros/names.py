# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Check names of topics and namespaces before rclpy gets them, whose errors are tracebacks of several lines."""

from __future__ import annotations

from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_topic_name import validate_topic_name


def find_name_fault(topic: str, namespace: str = '', node: str = 'node') -> str:
    """Return why a node cannot have a topic or a namespace of these names; empty where it can.

    Args:
        topic: name of the topic, absolute or relative to the namespace.
        namespace: namespace of the node, with or without the slash at its beginning.
        node: name of the node.
    """
    absolute = f'/{namespace.removeprefix("/")}'
    try:
        validate_namespace(absolute)
        validate_topic_name(topic)
        validate_full_topic_name(expand_topic_name(topic, node, absolute))
    except NameValidationException as error:  # `Invalid KIND: REASON:`, and lines that point into the name
        return str(error).splitlines()[0].partition(': ')[2].rstrip(':')
    except (ValueError, TypeError):  # an unknown {substitution}; a text that is no UTF-8
        return 'no name of a topic'
    return ''
