#!/bin/bash
# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
#
# Less frequent work, in the environment that `make setup` made:
#   task.sh format                 format the code
#   task.sh docs                   build the documentation site, into build/docs/html
#   task.sh links                  check the links of the site to other sites
#   task.sh fuzz SECONDS [SOURCE]  fuzz the readers of inputs from strangers (needs the extra fuzz)
#   task.sh properties ROUNDS      run the property tests with random inputs; failures are kept and come first next time
#   task.sh models MOTION.npz      retrain the shipped models from body26_30fps.npz (the lifter needs the extra train)
#   task.sh page                   bundle three.js for the page of mocap-ros view (needs npm)
#   task.sh lock                   write versions and hashes of what is installed, for `make setup LOCKED=1`
#   task.sh audit                  look for known holes in what is installed (needs the extra audit and a network)
#   task.sh sbom                   write the list of what is installed, build/sbom.json (needs the extra audit)
#   task.sh colcon                 build both packages with colcon, into install/
#   task.sh arm64                  compile for arm64 and run short tests, emulated, in 11 minutes (needs a network)
#   task.sh clean                  remove all that was made here, but your recordings
set -euo pipefail
cd "$(dirname "$0")/.."
export PATH="$PWD/.venv/bin:$PATH" PYTHONNOUSERSITE=1
mkdir -p build

sphinx() {
    config/env/setup.sh docs
    sphinx-build --fail-on-warning --keep-going --quiet -d build/docs/doctrees -b "$1" docs "build/docs/$1"
}

format() {
    ruff check --fix-only --quiet
    ruff format
}

docs() {
    sphinx html
    echo 'Site: build/docs/html/index.html'
}

links() {
    sphinx linkcheck
}

fuzz() {
    python -m tests.fuzz.run "${@:2}" --seconds "$1"
}

properties() {
    for ((round = 1; round <= $1; round++)); do
        python -m pytest --quiet --hypothesis-profile random -m 'hypothesis and not ros'
    done
}

models() {
    local category of_motion=("$1"
        --source 'CMU Graphics Lab Motion Capture Database, UI-PRMD and Perfume motion capture; 15 joints, 30 Hz, wrists where the hands bend'
        --acknowledgement 'The data used in this project was obtained from mocap.cs.cmu.edu. The database was created with funding from NSF EIA-0196217. UI-PRMD (A. Vakanski et al., University of Idaho) is in the public domain (Open Data Commons PDDL). Perfume motion data: MIT License, Copyright (c) 2012 Perfume Dev Team.')
    for category in walk run jump; do
        mocap-ros train "${of_motion[@]}" --category $category -o mocap_ros/models/shipped/$category.npz
    done
    mocap-ros train "${of_motion[@]}" -o mocap_ros/models/shipped/all.npz
    # first usual postures, then others from there on, so that usual ones keep their accuracy
    mocap-ros train --lifter "${of_motion[@]}" -o build/lifter.npz --checkpoint build/lifter.pt --steps 40000 \
        --without chair recline floor lie bridge handstand hang
    mocap-ros train --lifter "${of_motion[@]}" -o build/lifter_2.npz --start-from build/lifter.npz \
        --steps 4096 --seed 1 --without recline
    mocap-ros train --lifter "${of_motion[@]}" -o mocap_ros/models/shipped/lifter.npz --start-from build/lifter_2.npz \
        --steps 1024 --seed 2
    python benchmarks/motion_predictor.py
    python benchmarks/velocity_correction.py
    python -m mocap_ros.demo "$1"
}

page() {
    (cd config/page && npm ci --no-audit --no-fund --loglevel=error && npm run --silent build)
    sha256sum --check config/page/three.sha256
}

lock() {
    python config/env/lock.py >build/locked.txt
    mv build/locked.txt "config/env/locked-$(python config/env/lock.py --tag).txt"
}

# numpy is on PyPI: where the database does not know it, pip-audit has audited nothing and reports success all the same.
audit() {
    local status=0
    pip-audit --local --skip-editable >build/audit.txt 2>build/audit.log || status=$?
    if grep -q '^numpy .*could not be audited' build/audit.txt || grep -q '^Traceback' build/audit.log; then
        echo 'task.sh audit: nothing was audited, as the database of known holes cannot be reached (build/audit.log)' >&2
        exit 2
    fi
    cat build/audit.log build/audit.txt
    exit $status
}

sbom() {
    cyclonedx-py environment --output-reproducible --output-file build/sbom.part .venv/bin/python
    mv build/sbom.part build/sbom.json
}

colcon() {
    COLCON_HOME=$PWD/build/colcon command colcon --log-level error build
}

# Runs a program of Python on an emulated processor.
emulated() {
    PYTHONPATH=$PWD:build/arm64/wheels qemu-aarch64-static -L build/arm64/root build/arm64/root/usr/bin/python3.11 "$@"
}

arm64() {
    local folder=$PWD/build/arm64 package
    PATH+=:/usr/sbin
    if ! type debootstrap qemu-aarch64-static aarch64-linux-gnu-gcc >/dev/null 2>&1; then
        echo 'task.sh arm64: first: sudo apt install debootstrap qemu-user-static gcc-aarch64-linux-gnu' >&2
        exit 2
    fi
    mkdir -p "$folder/flags"
    if [ ! -e "$folder/root" ]; then
        rm -rf "$folder/packages" "$folder/root.part"
        debootstrap --arch=arm64 --download-only --variant=minbase --include=python3.11,libpython3.11-dev \
            bookworm "$folder/packages" >"$folder/packages.log"
        for package in "$folder"/packages/var/cache/apt/archives/*.deb; do
            dpkg -x "$package" "$folder/root.part"
        done
        mv "$folder/root.part" "$folder/root"
    fi
    if [ ! -e "$folder/wheels" ]; then
        rm -rf "$folder/wheels.part"
        python -c 'from importlib.metadata import requires; print(*requires("mocap-ros"), sep="\n")' >"$folder/needed.txt"
        pip install --quiet --target "$folder/wheels.part" --python-version 3.11 --only-binary=:all: \
            --platform manylinux_2_28_aarch64 --platform manylinux2014_aarch64 -r "$folder/needed.txt" pytest hypothesis
        mv "$folder/wheels.part" "$folder/wheels"
    fi
    # what Python on arm64 was compiled with, and how it names extensions
    cp "$folder/root/usr/lib/python3.11/_sysconfigdata__aarch64-linux-gnu.py" "$folder/flags"
    _PYTHON_SYSCONFIGDATA_NAME=_sysconfigdata__aarch64-linux-gnu PYTHONPATH=$folder/flags \
        CC="aarch64-linux-gnu-gcc --sysroot=$folder/root -I$folder/root/usr/include/python3.11" \
        python setup.py build_ext --inplace --build-temp "$folder/objects" >"$folder/compiler.log" 2>&1 ||
        { tail -n 15 "$folder/compiler.log" >&2; exit 1; }
    python benchmarks/golden.py record "$folder/golden.npz" --short
    # other instructions round otherwise: joints differ by 1e-7 m, velocities by 2e-6 m/s
    emulated benchmarks/golden.py compare "$folder/golden.npz" --short --tolerance 1e-5
    emulated -m pytest --quiet -k 'not histories' \
        tests/solvers/test_{extremities,footing,joint,periodic,posture,vertical,window}.py \
        tests/tracking/test_{checks,people,track,tracker}.py
}

clean() {
    rm -rf .venv build dist install log demo_output docs/project docs/reference ./*.egg-info
    rm -rf .coverage .hypothesis .mypy_cache .pytest_cache .ruff_cache config/page/node_modules
    find . -name __pycache__ -prune -exec rm -rf {} +
}

case ${1:-} in
    format | docs | links | page | lock | audit | sbom | colcon | arm64 | clean) "$1" ;;
    fuzz | properties | models)
        [ $# -ge 2 ] || { echo "task.sh $1: one more argument is needed" >&2; exit 2; }
        "$@" ;;
    *)
        sed -n 's/^#   task/config\/task/p' "$0"
        [ $# -eq 0 ] || exit 2 ;;
esac
