# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Coverage-guided fuzzing of one kind of input, or of all: `python -m tests.fuzz.run [SOURCE...] --seconds N`.

Atheris (the extra `fuzz`) mutates the valid inputs of `targets.py`, the inputs that once failed and what earlier
runs found in build/fuzz/SOURCE/corpus. A fault does not end the run: its input is written to
build/fuzz/SOURCE/faults, once for each place in the code.
"""

import argparse
import hashlib
import json
import re
import subprocess
import sys
import time
import traceback
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAILED = Path(__file__).parent / 'failed'  # the inputs that once failed, kept in a folder for each source
OUT = ROOT / 'build' / 'fuzz'
INPUT_S = 20  # s; a longer input is a fault. The readers need milliseconds, under instrumentation 0.1 s
MAX_RSS_MB = 2500  # memory of the process above which the input is a fault; Python and its libraries need 300 MB
MAX_INPUT_BYTES = 8192  # of an input; the examples are smaller
# Modules that are instrumented so that the mutations are led by what they execute.
INSTRUMENTED = (
    'mocap_ros.formats', 'mocap_ros.messages', 'mocap_ros.bags', 'mocap_ros.config', 'mocap_ros.npz_file',
    'mocap_ros.models.model_file', 'mocap_ros.skeleton', 'rosbags', 'mcap', 'yaml', 'ruamel',
)  # fmt: skip


def main() -> int:
    """Fuzz the sources one after the other; return 1 if a fault was found."""
    parser = argparse.ArgumentParser(description='Fuzz the readers of inputs from strangers.')
    parser.add_argument('sources', nargs='*', metavar='SOURCE', help='kinds of input; by default all')
    parser.add_argument('--seconds', type=int, default=60, help='time for each source, without its start')
    parser.add_argument('--worker', action='store_true', help=argparse.SUPPRESS)
    args, options = parser.parse_known_args()
    if args.worker:
        return _fuzz(args.sources[0], options)
    from tests.fuzz.targets import TARGETS

    results = []
    for source in args.sources or TARGETS:
        results.append(_run(source, args.seconds))
        print(json.dumps(results[-1]), flush=True)
    return int(any(result['faults'] for result in results))


def _run(source: str, seconds: int) -> dict[str, object]:
    """Fuzz a source in processes of its own, which a fault of a compiled library may end, and describe the run."""
    from tests.fuzz.targets import EXAMPLES

    corpus, faults = OUT / source / 'corpus', OUT / source / 'faults'
    for folder in (corpus, faults):
        folder.mkdir(parents=True, exist_ok=True)
    for data in EXAMPLES[source]():
        (corpus / f'example-{hashlib.sha1(data, usedforsecurity=False).hexdigest()[:12]}').write_bytes(data)
    folders = [str(folder) for folder in (corpus, FAILED / source) if folder.is_dir()]
    executions, end = 0, time.monotonic() + seconds
    while (left := int(end - time.monotonic())) > 0:
        command = [
            sys.executable, '-m', 'tests.fuzz.run', source, '--worker', f'-max_total_time={left}',
            f'-timeout={INPUT_S}', f'-rss_limit_mb={MAX_RSS_MB}', f'-max_len={MAX_INPUT_BYTES}',
            f'-artifact_prefix={faults}/', '-print_final_stats=1', *folders,
        ]  # fmt: skip
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, errors='replace', check=False)
        (OUT / source / 'log.txt').write_text(result.stderr)
        counts = re.findall(r'number_of_executed_units: (\d+)', result.stderr) or re.findall(
            r'^#(\d+)', result.stderr, re.MULTILINE
        )
        if not counts:
            raise SystemExit(f'{source}: the fuzzer did not start; see {OUT / source / "log.txt"}')
        executions += int(counts[-1])
    return {
        'source': source,
        'seconds': seconds,
        'executions': executions,
        'corpus': len(list(corpus.iterdir())),
        'faults': sorted(str(f.relative_to(ROOT)) for f in faults.iterdir() if f.suffix != '.txt'),
    }


def _fuzz(source: str, options: list[str]) -> int:
    """Fuzz a source in this process, which does not return."""
    import atheris

    with atheris.instrument_imports(include=list(INSTRUMENTED)):
        from tests.fuzz.targets import check
    seen = set()

    def test_one_input(data: bytes) -> None:
        try:
            check(source, data)
        except Exception as error:
            place = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)][-3:]
            if (key := (type(error), *place)) in seen:
                return
            seen.add(key)
            name = f'{type(error).__name__}-{hashlib.sha1(data, usedforsecurity=False).hexdigest()[:12]}'
            (OUT / source / 'faults' / name).write_bytes(data)
            (OUT / source / 'faults' / f'{name}.txt').write_text(traceback.format_exc(), errors='replace')

    atheris.Setup([sys.argv[0], *options], test_one_input)
    atheris.Fuzz()
    return 0


if __name__ == '__main__':
    sys.exit(main())
