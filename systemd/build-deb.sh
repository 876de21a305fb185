#!/bin/sh
# Build lookback_VERSION_ARCH.deb, which contains the virtual environment, so that it installs without a network.
# Usage: build-deb.sh [-o DIR] [options of install.sh: --wheel, --pypi, --extras, --python]
# MAINTAINER='Name <address>' sets who answers for the package.
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
mkdir -p "$stage/usr/lib/systemd" "$stage/usr/lib/udev" "$stage/usr/bin"
mv "$stage/etc/systemd/system" "$stage/usr/lib/systemd/system"
mv "$stage/etc/sysusers.d" "$stage/etc/tmpfiles.d" "$stage/usr/lib/"
mv "$stage/etc/udev/rules.d" "$stage/usr/lib/udev/"
mv "$stage/usr/local/bin/lookback" "$stage/usr/bin/"
doc=$stage/usr/share/doc/lookback
mkdir -p "$doc/examples" "$stage/usr/share/man/man1" "$stage/usr/share/lintian/overrides"
# Not a conffile: dpkg would ask about an edited one at an upgrade, and nobody is there to answer.
install -m 0644 "$here/../edge/default.toml" "$doc/examples/lookback.toml"
rm -r "${stage:?}/etc" "${stage:?}/usr/local"
cp "$here/deb/copyright" "$doc/"
cp "$here/deb/lintian-overrides" "$stage/usr/share/lintian/overrides/lookback"
gzip -9nc "$here/deb/lookback.1" >"$stage/usr/share/man/man1/lookback.1.gz"
find "$stage/opt/lookback/lib" -type f -perm /111 -exec chmod a-x {} +

version=$("$stage/opt/lookback/bin/python" -c 'from importlib.metadata import version; print(version("lookback-nav"))')
minor=$("$python" -c 'import sys; print(sys.version_info.minor)')
maintainer=${MAINTAINER:-The Lookback authors <lookback@lists.invalid>}
printf 'lookback (%s) unstable; urgency=medium\n\n  * See CHANGELOG.md.\n\n -- %s  %s\n' \
    "$version" "$maintainer" "$(date -R -d "@${SOURCE_DATE_EPOCH:-$(date +%s)}")" | gzip -9n >"$doc/changelog.gz"
mkdir "$stage/DEBIAN"
cp "$here/deb/preinst" "$here/deb/postinst" "$here/deb/prerm" "$here/deb/postrm" "$stage/DEBIAN/"
chmod 0755 "$stage/DEBIAN/"*
cat >"$stage/DEBIAN/control" <<TEXT
Package: lookback
Version: $version
Architecture: $(dpkg --print-architecture)
Maintainer: $maintainer
Installed-Size: $(du -sk "$stage" | cut -f1)
Depends: python3 (>= 3.$minor), python3 (<< 3.$((minor + 1))), libc6, libgcc-s1, libstdc++6, systemd, udev
Section: science
Priority: optional
Description: place recognition that gives an autopilot position fixes
 Recognizes places along a route with one camera, also in the opposite
 direction or in other light, and sends position fixes over MAVLink.
TEXT
(cd "$stage" && find . -path ./DEBIAN -prune -o -type f -printf '%P\0' | sort -z | xargs -0 md5sum >DEBIAN/md5sums)
chmod 0644 "$stage/DEBIAN/md5sums" "$stage/DEBIAN/control"

mkdir -p "$output"
# gzip: weights and compiled libraries gain little from xz, which takes minutes on a small computer.
dpkg-deb --root-owner-group -Zgzip --build "$stage" "$output"
