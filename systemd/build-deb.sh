#!/bin/sh
# Build lookback_VERSION_ARCH.deb, which contains the virtual environment, so that it installs without a network.
# Usage: build-deb.sh [-o DIR] [options of install.sh: --wheel, --pypi, --extras, --python]
#
# Build it on the release and architecture that it will run on, or in a container of it: a virtual environment
# works with one minor version of Python, and the package depends on that version.
set -eu
umask 022

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
output=.
python=/usr/bin/python3

if [ "${1:-}" = -o ]; then
    [ $# -ge 2 ] || { echo "build-deb.sh: -o needs a folder" >&2; exit 1; }
    output=$2
    shift 2
fi
previous=
for argument in "$@"; do
    [ "$previous" != --python ] || python=$argument
    previous=$argument
done
command -v dpkg-deb >/dev/null || { echo "build-deb.sh: needs dpkg-deb: apt install dpkg" >&2; exit 1; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
stage=$work/stage
"$here/install.sh" --root "$stage" "$@" >/dev/null

# A package installs its units and rules under /usr/lib; /etc is for the admin.
mkdir -p "$stage/usr/lib/systemd" "$stage/usr/lib/udev"
mv "$stage/etc/systemd/system" "$stage/usr/lib/systemd/system"
mv "$stage/etc/sysusers.d" "$stage/etc/tmpfiles.d" "$stage/usr/lib/"
mv "$stage/etc/udev/rules.d" "$stage/usr/lib/udev/"
rmdir "$stage/etc/systemd" "$stage/etc/udev"

version=$("$stage/opt/lookback/bin/python" -c 'from importlib.metadata import version; print(version("lookback-nav"))')
minor=$("$python" -c 'import sys; print(sys.version_info.minor)')
mkdir "$stage/DEBIAN"
echo /etc/lookback/lookback.toml >"$stage/DEBIAN/conffiles"
cat >"$stage/DEBIAN/control" <<TEXT
Package: lookback
Version: $version
Architecture: $(dpkg --print-architecture)
Maintainer: The Lookback authors <lookback@localhost>
Installed-Size: $(du -sk "$stage" | cut -f1)
Depends: python3 (>= 3.$minor), python3 (<< 3.$((minor + 1))), libstdc++6, systemd, udev
Section: science
Priority: optional
Description: place recognition that gives an autopilot position fixes
 Recognizes places along a route with one camera, also in the opposite
 direction or in other light, and sends position fixes over MAVLink.
TEXT

cat >"$stage/DEBIAN/postinst" <<'TEXT'
#!/bin/sh
set -e
[ "$1" = configure ] || exit 0
systemd-sysusers lookback.conf
systemd-tmpfiles --create lookback.conf
if [ -S /run/udev/control ]; then
    udevadm control --reload
    udevadm trigger --subsystem-match=usb --subsystem-match=tty
fi
# Only at the first installation: an admin may have disabled it later.
[ -n "$2" ] || systemctl enable --quiet lookback.service
if [ -d /run/systemd/system ]; then
    systemctl daemon-reload
    systemctl --no-block try-restart lookback.service  # it becomes ready only once its port exists
fi
TEXT
cat >"$stage/DEBIAN/prerm" <<'TEXT'
#!/bin/sh
set -e
[ "$1" = remove ] || exit 0
[ ! -d /run/systemd/system ] || systemctl stop lookback.service
systemctl disable --quiet lookback.service
TEXT
cat >"$stage/DEBIAN/postrm" <<'TEXT'
#!/bin/sh
set -e
case $1 in
    # Python may have compiled modules there that dpkg does not list.
    remove | purge) rm -rf /opt/lookback ;;
esac
if [ "$1" = purge ]; then rm -rf /etc/lookback /var/lib/lookback; fi
[ ! -d /run/systemd/system ] || systemctl daemon-reload
TEXT
chmod 0755 "$stage/DEBIAN/postinst" "$stage/DEBIAN/prerm" "$stage/DEBIAN/postrm"

mkdir -p "$output"
# gzip: weights and compiled libraries gain little from xz, which takes minutes on a small computer.
dpkg-deb --root-owner-group -Zgzip --build "$stage" "$output"
