"""`mocap-ros view`: files, and errors in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.cli.main import main
from tests.support.quick_options import QUICK_OPTIONS


def test_it_writes_a_page(short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / 'page.html'
    assert main(['view', str(short_recording), '-o', str(output), *QUICK_OPTIONS]) == 0
    assert capsys.readouterr().out == f'{output}\n'
    assert short_recording.name in output.read_text(encoding='utf-8')


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['nowhere.npz', '-o', 'x.html'], 'nowhere.npz: No such file'),
        (['RECORDING', '-o', 'x.pdf'], 'x.pdf: unknown file type; expected .html'),
        (['RECORDING', '-o', 'nowhere/x.html'], 'x.html: cannot be written: there is no folder nowhere'),
        (['RECORDING', '-o', 'x.html', '--person', '7'], 'do not apply to a'),
        (['walk.jpg', '-o', 'x.html'], 'walk.jpg: is an image'),
    ],
)
def test_a_failure_is_one_line_on_stderr(
    short_recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path('walk.jpg').write_bytes(b'image')
    assert main(['view', *(str(short_recording) if a == 'RECORDING' else a for a in arguments)]) == 1
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert message in error
    assert not Path('x.html').exists()


def test_the_input_is_never_overwritten(short_recording: Path, tmp_path: Path) -> None:
    link = tmp_path / 'link.html'
    link.symlink_to(short_recording)
    before = short_recording.read_bytes()
    assert main(['view', str(short_recording), '-o', str(link)]) == 1
    assert short_recording.read_bytes() == before
