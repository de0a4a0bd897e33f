# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the lifecycle nodes of this package share: their transitions, and how failures are reported."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from mocap_ros.errors import MocapError


class ManagedNode(LifecycleNode):
    """A lifecycle node of which a subclass says what is made when it is configured, and what runs while active."""

    def configure(self) -> None:
        """Make what the node needs; an error leaves the node unconfigured."""
        raise NotImplementedError

    def clean_up(self) -> None:
        """Discard what `configure` made, also where it failed half-way or was not called."""
        raise NotImplementedError

    def start_run(self) -> None:
        """Begin to work; an error leaves the node inactive."""
        raise NotImplementedError

    def stop_run(self) -> None:
        """End the work, also where `start_run` failed half-way or was not called."""
        raise NotImplementedError

    def start(self) -> None:
        """Configure and activate the node; if that fails, the reason is logged, and the node keeps running."""
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    def close(self) -> None:
        """Stop and clean up, in any state."""
        self.stop_run()
        self.clean_up()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure the node."""
        try:
            self.configure()
        except Exception as error:
            self._log_failure('configured', 'configure', error)
            self.clean_up()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the publishers, then start the run."""
        result = super().on_activate(state)
        try:
            self.start_run()
        except Exception as error:
            self._log_failure('activated', 'activate', error)
            self.stop_run()
            super().on_deactivate(state)
            return TransitionCallbackReturn.FAILURE
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the run, which still publishes, then deactivate the publishers."""
        self.stop_run()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        result = super().on_cleanup(state)
        self.clean_up()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and clean up."""
        self.stop_run()
        result = super().on_shutdown(state)
        self.clean_up()
        return result

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and clean up; the node can be configured again."""
        return self.on_shutdown(state)

    def create_steady_timer(self, period_s: float, callback: Callable[[], None]) -> object:
        """Create a timer of the steady clock, whatever the time of a simulation is."""
        return self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _log_failure(self, state: str, transition: str, error: Exception) -> None:
        """Log in one line why a transition failed."""
        reason = str(error) if isinstance(error, MocapError) else f'{type(error).__name__}: {error}'
        self.get_logger().error(
            f'{" ".join(reason.split())}; the node is not {state}: correct the cause, then run '
            f'`ros2 lifecycle set {self.get_fully_qualified_name()} {transition}`, or restart the node'
        )
