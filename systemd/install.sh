#!/bin/sh
# Install or update Lookback as a service; see --help. For systems with systemd and Python 3.10 to
# 3.14: Raspberry Pi OS, Debian, Ubuntu, Jetson Linux.
set -eu
umask 022 # the service's user must be able to read what root installs

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
prefix=/opt/lookback
link=/usr/local/bin/lookback
root=
wheel=
pypi=
extras=
python=/usr/bin/python3
action=install
newest=no
purge=no

usage() {
    cat <<TEXT
Usage: install.sh [--wheel FILE | --pypi VERSION] [--extras NAMES] [--newest] [--python PYTHON] [--root DIR]
       install.sh --uninstall [--purge] [--root DIR]

Installs or updates Lookback in $prefix with its service, user, udev rules and directories, and $link.
Run it as root. An existing config is kept, and so are extras that were installed before. A failed update leaves the old
version in place: also if the new one refuses a config that the old one accepts, or if the running service does not run for
a minute with it. A service that was disabled stays disabled.

  --wheel FILE      install this wheel (default: the checkout that contains this script)
  --pypi VERSION    install this version from PyPI
  --extras NAMES    install these extras of the package as well, for example oak,stream; the first installation
                    includes the extra page; "none" installs no extra, and no earlier one again. fc6 is the other network,
                    for non-commercial use: from the checkout, from a wheel beside that of --wheel, or from PyPI
  --newest          the newest version of each package, and not those of $here/lock, which this version was tested with
  --python PYTHON   the Python to use (default /usr/bin/python3)
  --root DIR        install below DIR and change nothing else: for packages and tests
  --uninstall       remove it; the config, maps and journal stay
  --purge           with --uninstall: remove the config, maps and journal as well
TEXT
}

die() {
    echo "install.sh: $*" >&2
    exit 1
}

value_of() {
    [ "$1" -ge 2 ] || die "$2 needs a value; see --help"
}

while [ $# -gt 0 ]; do
    case $1 in
        --wheel) value_of $# "$1"; wheel=$2; shift ;;
        --pypi) value_of $# "$1"; pypi=$2; shift ;;
        --extras) value_of $# "$1"; extras=$2; shift ;;
        --python) value_of $# "$1"; python=$2; shift ;;
        --root) value_of $# "$1"; root=${2%/}; shift ;;
        --newest) newest=yes ;;
        --uninstall) action=uninstall ;;
        --purge) purge=yes ;;
        -h | --help) usage; exit 0 ;;
        *) die "unknown option $1; see --help" ;;
    esac
    shift
done
[ "$purge" = no ] || [ "$action" = uninstall ] || die "--purge goes with --uninstall"
[ -z "$wheel" ] || [ -z "$pypi" ] || die "--wheel and --pypi exclude each other"
[ -z "$wheel" ] || [ -f "$wheel" ] || die "$wheel: no such file"
[ -n "$root" ] || [ "$(id -u)" = 0 ] || die "run it as root: sudo $0"
[ -n "$root" ] || [ "$(dpkg-query -Wf '${db:Status-Status}' lookback 2>/dev/null)" != installed ] \
    || die "the Debian package lookback is installed: update or remove it with apt"

# With --root, files are installed and no service of this system is changed.
live() {
    [ -z "$root" ] || return 0
    "$@"
}

# Systemd may not be running, for example while an image is built: this is not an error.
live_systemctl() {
    if [ -d /run/systemd/system ]; then live systemctl "$@"; fi
}

put() { # put SOURCE TARGET: can be repeated
    install -D -m 0644 "$here/$1" "$root$2"
}

what_to_install() { # prints a pip requirement; copies the checkout, because a build would leave files in it
    if [ -n "$wheel" ]; then
        spec=$(CDPATH='' cd -- "$(dirname -- "$wheel")" && pwd)/$(basename -- "$wheel")
    elif [ -n "$pypi" ]; then
        spec=lookback-nav
    else
        [ -f "$here/../pyproject.toml" ] || die "no checkout around this script: use --wheel or --pypi"
        mkdir "$work/source"
        for name in pyproject.toml setup.py README.md LICENSE edge edge_plugins lookback sim; do
            [ ! -e "$here/../$name" ] || cp -R "$here/../$name" "$work/source/"
        done
        spec=$work/source
    fi
    [ -z "$extras" ] || spec="${spec}[$extras]"
    [ -z "$pypi" ] || spec="$spec==$pypi"
    echo "$spec"
}

has_extra() {
    case ,$extras, in
        *,"$1",*) ;;
        *) return 1 ;;
    esac
}

install_fc6() { # before the extra that asks for it
    if [ -n "$wheel" ]; then
        install_packages --no-deps --find-links "$(dirname -- "$wheel")" lookback-fc6 \
            || die "the network fc6 is a package of its own: copy lookback_fc6-*.whl beside $wheel, or --extras none"
    elif [ -z "$pypi" ]; then
        [ -d "$here/../lookback_fc6" ] || die "no lookback_fc6 in the checkout, which the extra fc6 needs"
        cp -R "$here/../lookback_fc6" "$work/fc6" # a build would leave files in it
        install_packages --no-deps "$work/fc6"
    fi
}

installed_extras() { # prints those of the installed version whose packages are all there, with commas
    # By the new Python: after an upgrade of the system, the old environment's own finds none of its packages.
    "$python" "$here/installed_extras.py" "$root$prefix"/lib/python3*/site-packages
}

choose_extras() {
    case $extras in
        none) extras= ;;
        *)
            kept=page
            if [ -e "$root$prefix/pyvenv.cfg" ] && ! kept=$(installed_extras); then
                [ -n "$extras" ] || die "cannot find out which extras are installed; name them with --extras"
                kept=
            fi
            # Until it was a package of its own, fc6 was in every version, and a config that names no network means it.
            for old in "$root$prefix"/lib/python3*/site-packages/edge/descriptor/models/alexnet_places100; do
                [ ! -d "$old" ] || kept=$kept${kept:+,}fc6
            done
            given=$extras extras=$kept
            for one in $(echo "$given" | tr , ' '); do
                has_extra "$one" || extras=$extras${extras:+,}$one
            done
            ;;
    esac
}

check_python() {
    command -v "$python" >/dev/null || die "$python: no such program; install it: apt install python3 python3-venv"
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])') || die "$python does not run as Python"
    case $version in
        3.10 | 3.11 | 3.12 | 3.13 | 3.14) ;;
        *) die "$python is Python $version, and Lookback needs 3.10 to 3.14; name one with --python" ;;
    esac
    "$python" -c 'import ensurepip, venv' 2>/dev/null || die "$python has no venv: apt install python$version-venv"
}

install_packages() {
    "$stage/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --no-warn-script-location "$@"
}

install_locked() { # the same bytes on every vehicle: compiled packages of known hashes; Lookback itself comes after them
    set -- -r "$here/lock/core.txt" -r "$here/lock/build.txt"
    for extra in $(echo "$extras" | tr , ' '); do
        if [ "$extra" = fc6 ]; then
            continue # it needs no other package
        elif [ -e "$here/lock/$extra.txt" ]; then
            set -- "$@" -r "$here/lock/$extra.txt"
        else
            echo "install.sh: the extra $extra has no file in $here/lock: its newest packages are installed" >&2
        fi
    done
    install_packages --require-hashes --only-binary :all: "$@"
}

make_venv() { # at $stage, with every path in it as if it were at $prefix
    check_python
    home=$("$python" -c 'import sys; print(sys.base_prefix)')
    case $home in
        /home/* | /root/*) [ -n "$root" ] || die "$python is in $home, which the service cannot read (ProtectHome)" ;;
    esac
    "$python" -m venv "$stage"
    spec=$(what_to_install)
    [ "$newest" = yes ] || install_locked
    ! has_extra fc6 || install_fc6
    install_packages "$spec"
    [ "$newest" = yes ] || "$stage/bin/python" -m pip check >&2 \
        || die "this version needs other packages than $here/lock has: take its own install.sh, or --newest"
    grep -rlIF -- "$stage" "$stage/bin" "$stage/pyvenv.cfg" | while IFS= read -r file; do
        sed -i "s|$stage|$prefix|g" "$file"
    done
    # The service cannot write here, so compile the modules now. Packages also contain files for other Python
    # versions, which do not compile, and some of which Python 3.14 warns.
    PYTHONWARNINGS=ignore "$stage/bin/python" -m compileall -q -j 0 -s "$stage" -p "$prefix" "$stage/lib" || true
}

accepts_config() { # accepts_config ENVIRONMENT: whether its version accepts the config and the files that it names
    (cd / && "$1/bin/python" -m edge doctor --offline "$root/etc/lookback/lookback.toml") >"$work/doctor" 2>&1
}

check_config() { # what the old version refuses as well, such as a map that is not built yet, is no reason to stop
    [ -e "$root/etc/lookback/lookback.toml" ] && [ -e "$root$prefix" ] || return 0
    if accepts_config "$root$prefix" && ! accepts_config "$stage"; then
        grep -v '^ok  ' "$work/doctor" >&2 || true
        die "the new version refuses the config, so the old one stays"
    fi
}

swap_venv() {
    rm -rf "$root$prefix.old"
    [ ! -e "$root$prefix" ] || mv "$root$prefix" "$root$prefix.old"
    mv "$stage" "$root$prefix"
}

units() { # those that an update replaces
    for unit in lookback.service lookback-camera.socket lookback-camera@.service; do
        [ ! -e "$root/etc/systemd/system/$unit" ] || echo "$root/etc/systemd/system/$unit"
    done
}

runs() { # whether the service runs, by the process that it was started with
    pid=$(systemctl show -p MainPID --value lookback.service)
    [ "$pid" != 0 ] && [ "${1:-$pid}" = "$pid" ] && systemctl is-active --quiet lookback.service
}

restart_or_roll_back() { # the old version is kept until the new one has run for a minute
    runs || return 0
    if systemctl restart lookback.service && runs; then
        since=$pid
        for _ in 1 2 3 4 5 6 7 8 9 10 11 12; do
            sleep 5
            runs "$since" || break
        done
        if runs "$since"; then return 0; fi
    fi
    rm -rf "$root$prefix"
    mv "$root$prefix.old" "$root$prefix"
    cp -p "$work/units/"* "$root/etc/systemd/system/"
    systemctl daemon-reload
    systemctl restart lookback.service || true
    die "the new version did not run for a minute, so the old one is back: journalctl -eu lookback"
}

clean_up_after_a_kill() { # of an earlier run of this script, at any point
    rm -rf "$root$prefix.new".??????
    [ -e "$root$prefix" ] || [ ! -e "$root$prefix.old" ] || mv "$root$prefix.old" "$root$prefix"
    rm -rf "$root$prefix.old"
}

put_link() {
    mkdir -p "$root$(dirname "$link")"
    if [ "$(readlink "$root$link")" = "$prefix/bin/lookback" ] || [ ! -e "$root$link" ]; then
        ln -sfn "$prefix/bin/lookback" "$root$link"
    else
        echo "install.sh: $link belongs to something else, and stays" >&2
    fi
}

put_files() {
    put lookback.service /etc/systemd/system/lookback.service
    put lookback-camera.socket /etc/systemd/system/lookback-camera.socket
    put lookback-camera@.service /etc/systemd/system/lookback-camera@.service
    put lookback.sysusers /etc/sysusers.d/lookback.conf
    put lookback.tmpfiles /etc/tmpfiles.d/lookback.conf
    put 70-lookback.rules /etc/udev/rules.d/70-lookback.rules
    version=$(systemctl --version 2>/dev/null | sed -n '1s/^systemd \([0-9]*\).*/\1/p')
    if [ "${version:-0}" -ge 254 ]; then
        put lookback-backoff.conf /etc/systemd/system/lookback.service.d/backoff.conf
    fi
    if [ ! -e "$root/etc/lookback/lookback.toml" ]; then
        default=$(find "$root$prefix/lib" -path '*/site-packages/edge/start.toml')
        [ -f "$default" ] || die "the package has no start.toml"
        install -D -m 0640 "$default" "$root/etc/lookback/lookback.toml"
    fi
}

reload_udev() {
    if [ -S /run/udev/control ]; then
        live udevadm control --reload
        live udevadm trigger --subsystem-match=usb --subsystem-match=tty
    fi
}

lock() { # until this script ends
    mkdir -p "$root$(dirname "$prefix")"
    exec 9<"$root$(dirname "$prefix")"
    flock -n 9 || die "another install.sh is running"
}

install_all() {
    lock
    clean_up_after_a_kill
    choose_extras
    first=yes
    [ ! -e "$root/etc/systemd/system/lookback.service" ] || first=no
    work=$(mktemp -d "$root$prefix.new.XXXXXX")
    trap 'rm -rf "$work"' EXIT
    trap 'exit 130' INT TERM
    stage=$work/venv
    make_venv
    check_config
    mkdir "$work/units"
    units | while IFS= read -r unit; do cp -p "$unit" "$work/units/"; done
    swap_venv
    put_files
    put_link
    live systemd-sysusers lookback.conf
    live systemd-tmpfiles --create lookback.conf
    live reload_udev
    live_systemctl daemon-reload
    [ "$first" = no ] || live_systemctl enable --quiet lookback.service # an admin may have disabled it later
    [ "$first" = yes ] || [ ! -d /run/systemd/system ] || live restart_or_roll_back
    rm -rf "$root$prefix.old"
    if [ "$first" = no ]; then
        echo "Lookback is updated${extras:+, with the extras $extras}."
        return
    fi
    cat <<TEXT
Lookback is installed in $root$prefix${extras:+ with the extras $extras}, and starts at boot. Next:
  1. edit  $root/etc/lookback/lookback.toml
  2. build a map of the route at the path in the config (lookback record, lookback map build)
  3. check sudo lookback doctor /etc/lookback/lookback.toml
  4. start systemctl start lookback, and watch it with journalctl -fu lookback
TEXT
}

remove_user() { # nothing is left that belongs to it
    if getent passwd lookback >/dev/null; then userdel lookback; fi
}

uninstall_all() {
    lock
    if [ -e "$root/etc/systemd/system/lookback.service" ]; then
        live_systemctl disable --now --quiet lookback.service lookback-camera.socket
    fi
    rm -f "$root/etc/systemd/system/lookback.service" "$root/etc/systemd/system/lookback-camera.socket" \
        "$root/etc/systemd/system/lookback-camera@.service" "$root/etc/sysusers.d/lookback.conf" \
        "$root/etc/tmpfiles.d/lookback.conf" "$root/etc/udev/rules.d/70-lookback.rules" \
        "$root/etc/systemd/system/lookback.service.d/backoff.conf"
    rmdir "$root/etc/systemd/system/lookback.service.d" 2>/dev/null || true # kept if the admin has drop-ins in it
    rm -rf "$root$prefix" "$root$prefix.old" "$root$prefix.new".??????
    [ "$(readlink "$root$link")" != "$prefix/bin/lookback" ] || rm "$root$link"
    live_systemctl daemon-reload
    live reload_udev
    if [ "$purge" = yes ]; then
        rm -rf "$root/etc/lookback" "$root/var/lib/lookback"
        live remove_user
        echo "Lookback is removed, with its config, maps and journal."
    else
        echo "Lookback is removed; $root/etc/lookback and $root/var/lib/lookback are kept (--purge removes them)."
    fi
}

"${action}_all"
