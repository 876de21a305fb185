#!/bin/sh
# Build lookback_VERSION_ARCH.deb, which contains the virtual environment, so that it installs without a network; --help.
set -eu
umask 022

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
output=.
python=/usr/bin/python3
maintainer=${MAINTAINER:-}

usage() {
    cat <<TEXT
Usage: build-deb.sh --maintainer 'NAME <ADDRESS>' [-o DIR] [options of install.sh]

Builds lookback_VERSION_ARCH.deb from the packages of $here/lock. Build it on the release and the
architecture that it will run on, or in a container of it: it depends on that minor version of Python.

  --maintainer WHO  who answers for this package, as 'Name <address>'; or the environment variable MAINTAINER
  -o DIR            write the package to this folder (default .)
  --wheel FILE, --pypi VERSION, --extras NAMES, --newest, --python PYTHON: see install.sh --help
TEXT
}

die() {
    echo "build-deb.sh: $*" >&2
    exit 1
}

given=$#
while [ "$given" -gt 0 ]; do # what is not of this script goes to install.sh, in its order
    argument=$1
    shift
    given=$((given - 1))
    case $argument in
        -h | --help) usage; exit 0 ;;
        -o | --maintainer | --python)
            [ "$given" -gt 0 ] || die "$argument needs a value; see --help"
            value=$1
            shift
            given=$((given - 1))
            case $argument in
                -o) output=$value ;;
                --maintainer) maintainer=$value ;;
                --python) python=$value; set -- "$@" --python "$value" ;;
            esac
            ;;
        *) set -- "$@" "$argument" ;;
    esac
done
case $maintainer in
    *?' <'?*@?*'>') ;;
    *) die "who answers for this package? --maintainer 'Name <address>'" ;;
esac
command -v dpkg-deb >/dev/null || die "needs dpkg-deb: apt install dpkg"

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

site=$(echo "$stage"/opt/lookback/lib/python3*/site-packages)
version=$("$stage/opt/lookback/bin/python" -c 'from importlib.metadata import version; print(version("lookback-nav").replace(".dev", "~dev"))')
minor=$("$python" -c 'import sys; print(sys.version_info.minor)')
sh "$here/trim.sh" "$stage/opt/lookback"

"$python" "$here/components.py" "$site" sbom >"$doc/sbom.cdx.json"
{ cat "$here/deb/copyright"; "$python" "$here/components.py" "$site" copyright; } >"$doc/copyright"
cp "$here/deb/lintian-overrides" "$stage/usr/share/lintian/overrides/lookback"
gzip -9nc "$here/deb/lookback.1" >"$stage/usr/share/man/man1/lookback.1.gz"
find "$stage/opt/lookback/lib" -type f -perm /111 -exec chmod a-x {} +

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
# xz: three quarters of what gzip needs, for four minutes of one core more.
dpkg-deb --root-owner-group -Zxz --build "$stage" "$output"
