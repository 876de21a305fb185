#!/usr/bin/env bash
# Makes a folder with Python for aarch64 and the packages that tests/descriptor/test_processors.py runs under emulation:
#     tests/descriptor/make_aarch64_root.sh /tmp/aarch64 && LOOKBACK_AARCH64_ROOT=/tmp/aarch64 make test
# Needs Debian or Ubuntu (apt-get download), Python with pip, and nothing of root's rights.
set -euo pipefail
[ $# -eq 1 ] || { echo "usage: $0 FOLDER" >&2; exit 2; }
mkdir -p "$1"
root=$(cd "$1" && pwd)
python=${PYTHON:-.venv/bin/python}
version=$($python -c 'import sys; print("%d.%d" % sys.version_info[:2])')
mkdir -p "$root/debs" "$root/lists/partial" "$root/wheels" "$root/packages"
apt=(-oAPT::Architecture=arm64 -oAPT::Architectures=arm64 "-oDir::State::Lists=$root/lists")
apt-get "${apt[@]}" update -qq
(cd "$root/debs" && apt-get "${apt[@]}" download -qq libc6 "libpython$version-minimal" "libpython$version-stdlib" \
    "python$version-minimal" zlib1g libexpat1 libssl3 libbz2-1.0 liblzma5 libffi8 libgcc-s1 libstdc++6 libuuid1 libgomp1)
for deb in "$root"/debs/*.deb; do dpkg -x "$deb" "$root"; done
ln -sf "python$version" "$root/usr/bin/python3"
platforms=()
for tag in manylinux_2_34 manylinux_2_28 manylinux_2_27 manylinux_2_17 manylinux2014; do platforms+=(--platform "${tag}_aarch64"); done
packages=()
for name in numpy opencv-python-headless onnxruntime numkong msgspec pyproj pymavlink pyserial tomli-w tqdm \
    starlette uvicorn prometheus-client; do
    packages+=("$($python -c "from importlib.metadata import version; print('$name==' + version('$name'))")")
done
$python -m pip download -q --only-binary=:all: --python-version "$version" --implementation cp "${platforms[@]}" \
    -d "$root/wheels" "${packages[@]}"
for wheel in "$root"/wheels/*.whl; do $python -m zipfile -e "$wheel" "$root/packages"; done
# Of a Cortex-A76: ONNX Runtime since 1.28 crashes at its import where it reads the /proc/cpuinfo of the x86-64 computer.
mkdir -p "$root/proc"
printf 'processor\t: 0\nFeatures\t: fp asimd aes pmull sha1 sha2 crc32 atomics fphp asimdhp asimdrdm lrcpc dcpop asimddp
CPU implementer\t: 0x41\nCPU architecture: 8\nCPU variant\t: 0x4\nCPU part\t: 0xd0b\nCPU revision\t: 1\n' >"$root/proc/cpuinfo"
echo "LOOKBACK_AARCH64_ROOT=$root"
