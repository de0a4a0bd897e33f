# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Files that are written are there whole or not at all."""

import errno
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.text_files import replace_output


@pytest.mark.parametrize('is_old', [False, True])
@pytest.mark.parametrize(
    ('error', 'told', 'message'),
    [
        (OSError(errno.ENOSPC, 'No space left'), MocapError, r'out\.npz: cannot be written: No space left$'),
        (InputError('frame 3'), InputError, 'frame 3'),
        (KeyboardInterrupt(), KeyboardInterrupt, '^$'),
        (SystemExit(1), SystemExit, '1'),
    ],
)
def test_an_error_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, error: BaseException, told: type[BaseException], message: str, is_old: bool
) -> None:
    path = tmp_path / 'out.npz'
    if is_old:
        path.write_text('old')

    def write() -> None:
        with replace_output(path) as unfinished:
            assert unfinished.name == 'out.npz'
            unfinished.write_text('ne')
            raise error

    with pytest.raises(told, match=message) as raised:
        write()
    assert type(raised.value) is told
    assert [file.read_text() for file in tmp_path.iterdir()] == ['old'] * is_old


def test_an_existing_file_keeps_its_permissions_and_a_new_one_has_the_usual_ones(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        for name, mode in (('old.npz', 0o604), ('new.npz', None)):
            path = tmp_path / name
            if mode is not None:
                path.write_text('old')
                path.chmod(mode)
            with replace_output(path) as unfinished:
                unfinished.write_text('new')
            assert path.read_text() == 'new'
            assert stat.S_IMODE(path.stat().st_mode) == (mode or 0o640)
    finally:
        os.umask(before)


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    for folder in ('here', 'there'):
        (tmp_path / folder).mkdir()
    link, file = tmp_path / 'here' / 'link.npz', tmp_path / 'there' / 'data'
    link.symlink_to(file)
    for content in ('first', 'second'):
        with replace_output(link) as unfinished:
            assert unfinished.name == 'link.npz'
            assert unfinished.parent.parent == file.parent
            unfinished.write_text(content)
        assert link.is_symlink()
        assert file.read_text() == content
    assert set(tmp_path.rglob('*')) == {link.parent, file.parent, link, file}


def test_a_source_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / 'in').write_text('old')
    (tmp_path / 'out').symlink_to('in')
    places = [tmp_path / name for name in ('out', 'other', 'in')]
    message = 'out: not written, because it is the input file'
    with pytest.raises(MocapError, match=message), replace_output(*places) as unfinished:
        unfinished.write_text('new')
    assert (tmp_path / 'in').read_text() == 'old'


def test_the_standard_output_is_written_directly(tmp_path: Path) -> None:
    """Also where it leads to a file, which has no name that could be given to another one."""
    code = (
        'from pathlib import Path; from mocap_ros.formats.text_files import replace_output\n'
        "with replace_output(Path('/dev/stdout')) as place: place.write_text(str(place))\n"
    )
    with (tmp_path / 'out').open('wb') as file:
        subprocess.run([sys.executable, '-c', code], cwd=tmp_path, stdout=file, check=True)
        assert os.fstat(file.fileno()).st_ino == (tmp_path / 'out').stat().st_ino
    assert (tmp_path / 'out').read_text() == '/dev/stdout'
