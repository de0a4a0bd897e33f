"""The demo as a newcomer runs it, at twice the recorded pace."""

from pathlib import Path

import pytest

from mocap_ros.cli.main import main


@pytest.mark.ros
@pytest.mark.slow
def test_the_demo_writes_a_bag_and_a_picture(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('rclpy')
    pytest.importorskip('mocap_ros_msgs')
    assert main(['demo', '-o', str(tmp_path), '--rate', '2']) == 0
    output = capfd.readouterr().out
    assert 'Mean 3D error' in output
    assert output.endswith('5 frames had no keypoints\n')
    (metadata,) = tmp_path.glob('*/metadata.yaml')
    assert list(metadata.parent.glob('*.mcap'))
    assert (tmp_path / 'demo.png').read_bytes().startswith(b'\x89PNG')
