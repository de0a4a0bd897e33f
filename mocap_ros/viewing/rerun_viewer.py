# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Start Rerun's viewer for this machine's user alone: at 127.0.0.1, on a port of its own, without telemetry.

By default Rerun listens on all interfaces, streams into whatever viewer has its port already, and reports how it
is used. The settings of the user's own Rerun are left as they are.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from mocap_ros.errors import MocapError
from mocap_ros.viewing.rerun_recording import import_rerun

LOCALHOST = '127.0.0.1'
START_TIMEOUT_S = 30.0  # s; a viewer that does not listen by then has failed; a busy machine takes 5 s
POLL_S = 0.05  # s; pause between two attempts to reach the viewer
DISPLAY_VARIABLES = ('DISPLAY', 'WAYLAND_DISPLAY')  # one of them is set where windows can be shown


def require_display() -> None:
    """Check that windows can be shown.

    Raises:
        MocapError: there is no display; the error says what to do without one.
    """
    if sys.platform == 'linux' and not any(os.environ.get(name) for name in DISPLAY_VARIABLES):
        raise MocapError(
            'there is no display for a window; a recording becomes a file with mocap-ros view IN -o page.html'
        )


@contextmanager
def start_viewer(*files: Path, options: tuple[str, ...] = ()) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start the viewer in a process of its own; it is stopped at the end of the context.

    Args:
        files: recordings to show.
        options: further options of the viewer.

    Yields:
        The process, and the address on which it receives recordings.

    Raises:
        MocapError: Rerun is not installed, no window can be shown, or the viewer does not start.
    """
    import_rerun()
    require_display()
    port = find_free_port()
    with TemporaryDirectory(prefix='mocap_ros_rerun_') as settings:
        environment = {**os.environ, **disable_telemetry(Path(settings))}
        command = [*viewer_command(), '--bind', LOCALHOST, '--port', str(port), *options, *map(str, files)]
        process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            _wait_until_it_listens(process, port)
            yield process, f'rerun+http://{LOCALHOST}:{port}/proxy'
        finally:
            process.terminate()
            process.wait()


def viewer_command() -> list[str]:
    """Return the command that starts Rerun's own program, without a wrapper that would leave it running."""
    import rerun_cli

    program = Path(rerun_cli.__file__).with_name('rerun')
    return [str(program)] if program.exists() else [sys.executable, '-m', 'rerun_cli']


def find_free_port() -> int:
    """Return a port of 127.0.0.1 that nobody listens on."""
    with socket.socket() as server:
        server.bind((LOCALHOST, 0))
        return int(server.getsockname()[1])


def disable_telemetry(folder: Path) -> Mapping[str, str]:
    """Turn telemetry off in settings of Rerun in a folder; return the environment that makes Rerun use them."""
    environment = {'XDG_CONFIG_HOME': str(folder)}
    command = [*viewer_command(), 'analytics', 'disable']
    subprocess.run(
        command,
        env={**os.environ, **environment},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    return environment


def _wait_until_it_listens(process: subprocess.Popen[bytes], port: int) -> None:
    """Wait until the viewer accepts connections.

    Raises:
        MocapError: the viewer has stopped, or does not listen after `START_TIMEOUT_S`.
    """
    end = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < end:
        if process.poll() is not None:
            raise MocapError(f"Rerun's viewer stopped at once (exit code {process.returncode})")
        with socket.socket() as client:
            client.settimeout(POLL_S)
            if client.connect_ex((LOCALHOST, port)) == 0:
                return
        time.sleep(POLL_S)
    raise MocapError(f"Rerun's viewer did not start within {START_TIMEOUT_S:.0f} s")
