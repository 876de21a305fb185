#!/bin/bash
# Boot a real Debian in a container, install Lookback as README says, and try what happens to a service: starts, crashes,
# hangs, a slow disk, missing devices, unreadable paths, updates, failed and killed updates, a rollback, the Debian package, removal.
# Usage: sudo tests/systemd/boot.sh [WORK]   (default /var/tmp/lookback-boot; about 3 GB, kept for the next run)
# Needs mmdebstrap and systemd-container; PYTHON with Lookback's packages makes the map (default .venv/bin/python).
# Exit code 77: this computer cannot boot one, and why. DEB=FILE uses a package that build-deb.sh has made for Debian 12;
# ONLY=package tries the package alone.
set -euo pipefail
here=$(cd "$(dirname "$0")/../.." && pwd)
work=${1:-/var/tmp/lookback-boot}
root=$work/root
python=${PYTHON:-$here/.venv/bin/python}
name=lookback-boot
nspawn=
started=$SECONDS

skip() { echo "SKIPPED: $*"; exit 77; }
fail() { echo "FAILED: $*"; inside journalctl -u lookback -n 30 --no-pager || true; exit 1; }
step() { printf '%4d s  %s\n' $((SECONDS - started)) "$*"; }

[ "$(id -u)" = 0 ] || skip "needs root"
for tool in mmdebstrap systemd-nspawn nsenter unshare; do
    command -v $tool >/dev/null || skip "needs $tool: apt install mmdebstrap systemd-container util-linux"
done

inside() { # a command in the booted system
    nsenter -t "$(pgrep -P "$nspawn")" --all env -i PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        HOME=/root LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive PIP_CERT=/etc/ssl/certs/ca-certificates.crt "$@"
}

property() { inside systemctl show lookback --property="$1" --value; }

wait_for() { # SECONDS COMMAND...: until it succeeds
    local end=$((SECONDS + $1))
    shift
    until "$@" >/dev/null 2>&1; do
        [ $SECONDS -lt $end ] || return 1
        sleep 0.5
    done
}

make_root() {
    [ -e "$root/usr/bin/python3" ] && return
    mkdir -p "$work"
    mmdebstrap --quiet --variant=minbase bookworm "$root" \
        --include=systemd,systemd-sysv,dbus,udev,python3,python3-venv,ca-certificates,libstdc++6,procps,init-system-helpers
}

boot() {
    local host=()
    # Without systemd on this computer there is nobody to register with, and only the unified hierarchy is of use.
    [ -d /run/systemd/system ] || host=(--register=no --keep-unit)
    SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1 systemd-nspawn --quiet -D "$root" --boot --machine=$name --console=pipe \
        --bind-ro=/etc/ssl/certs/ca-certificates.crt --bind-ro=/etc/resolv.conf "${host[@]}" \
        </dev/null >"$work/console.log" 2>&1 &
    nspawn=$!
    wait_for 60 pgrep -P $nspawn || skip "systemd-nspawn does not start: $(tail -n 1 "$work/console.log")"
    wait_for 120 inside systemctl is-system-running --wait \
        || skip "it does not finish its boot: $(inside systemctl is-system-running; inside systemctl --failed --no-legend)"
}

power_off() {
    [ -n "$nspawn" ] || return 0
    inside systemctl poweroff 2>/dev/null || true
    wait "$nspawn" 2>/dev/null || true
    nspawn=
    # Made by systemd-nspawn where systemd does not run, and kept by it.
    local groups
    groups=$(findmnt --noheadings --first-only --output TARGET --types cgroup2 || true)
    [ -d /run/systemd/system ] || [ -z "$groups" ] \
        || rmdir "$groups"/payload/init.scope "$groups"/payload "$groups"/supervisor 2>/dev/null || true
}
trap power_off EXIT

write_config() { # KEY=VALUE of one line that is changed
    {
        printf '[descriptor]\nmodel = "grid"\n[recording]\n[camera]\nkind = "feed"\ndevice = "/var/lib/lookback/feed"\n[sampling]\nby = "frames"\n'
        printf '[map]\npath = "/var/lib/lookback/map"\n[sequence]\nlength = 4\n'
        printf '[telemetry]\nconnection = "udp:127.0.0.1:9"\n'
    } | case ${1:-} in
        "") cat ;;
        *) sed "s|^\($(echo "${1%%=*}" | sed 's/ *$//')\) = .*|$1|; s|^\[${2:-none}\]$|&\n$1|" ;;
    esac >"$root/etc/lookback/lookback.toml"
}

make_data() { # a feed that plays for four hours, longer than all of this on a slow machine, and a map of its beginning
    [ -e "$work/data/map" ] || (cd "$here" && "$python" -m tests.systemd.boot_data "$work/data")
    mkdir -p "$root/var/lib/lookback" "$root/etc/lookback"
    cp -r "$work/data/feed" "$work/data/map" "$root/var/lib/lookback/"
    chmod -R a+rX "$root/var/lib/lookback"
}

restarted() { [ "$(property NRestarts)" -gt "$1" ] && [ "$(property ActiveState)" = active ]; }
is_active() { [ "$(property ActiveState)" = active ] && [ "$(property MainPID)" != 0 ]; }
status_says() { property StatusText | grep -q -- "$1"; }
log_says() { inside journalctl -u lookback -n 40 --no-pager -o cat | grep -q -- "$1"; }

try_missing_port_at_boot() {
    write_config 'connection = "serial:/dev/ttyMISSING:921600"'
    power_off
    boot
    is_active || fail "a missing port keeps the service from starting"
    wait_for 20 status_says "/dev/ttyMISSING: no such port" || fail "status: $(property StatusText)"
    step "boot finished without the port; status: $(property StatusText)"
}

try_crash_and_hang() {
    local before
    write_config
    inside systemctl restart lookback
    before=$(property NRestarts)
    inside systemctl kill --kill-whom=main --signal=KILL lookback
    wait_for 60 restarted "$before" || fail "not restarted after kill -9"
    step "kill -9: restarted"
    before=$(property NRestarts)
    inside systemctl kill --kill-whom=main --signal=STOP lookback
    wait_for 90 restarted "$before" || fail "not restarted by the watchdog"
    log_says "Watchdog timeout" || fail "no watchdog timeout in the log"
    step "stopped process: restarted by the watchdog"
}

try_slow_disk() { # each write and flush of the service takes 2 s, for four times WatchdogSec=
    local before began drop_in=$root/run/systemd/system/lookback.service.d
    command -v cc >/dev/null || { step "no C compiler here: the slow disk was not tried"; return; }
    cc -shared -fPIC -O2 -o "$root/usr/lib/slow_writes.so" "$here/tests/faults/slow_writes_shim.c" -ldl
    write_config 'journal_frames = true' telemetry
    inside mkdir -p "${drop_in#"$root"}"
    inside tee "${drop_in#"$root"}/slow.conf" >/dev/null <<<$'[Service]\nEnvironment=LD_PRELOAD=/usr/lib/slow_writes.so SLOW_US=2000000'
    inside systemctl daemon-reload
    inside systemctl restart lookback || fail "it does not start on a slow disk"
    before=$(property NRestarts),$(property MainPID)
    inside grep -q slow_writes "/proc/$(property MainPID)/maps" || fail "its writes are not slow"
    sleep 40
    [ "$(property NRestarts),$(property MainPID)" = "$before" ] || fail "the watchdog ended it on a slow disk"
    [ "$(property ActiveState)" = active ] || fail "slow disk: $(property ActiveState)"
    began=$SECONDS
    inside systemctl stop lookback
    [ "$(property Result)" = success ] || fail "slow disk: stopped with $(property Result)"
    step "each write takes 2 s: runs on for 40 s; status: $(property StatusText); stopped within $((SECONDS - began + 1)) s"
    inside rm -r "${drop_in#"$root"}"
    rm "$root/usr/lib/slow_writes.so"
    inside systemctl daemon-reload
    write_config
    inside systemctl start lookback || fail "it does not start after the slow disk"
}

refused() { # KEY = VALUE that the service cannot read, SECTION where the key is not in the config
    write_config "$@"
    inside systemctl restart lookback 2>/dev/null && fail "the service starts with $1"
    [ "$(property ExecMainStatus)" = 78 ] || fail "$1: exit status $(property ExecMainStatus)"
    [ "$(property ActiveState)" = failed ] || fail "$1: $(property ActiveState)"
    log_says "ProtectHome" || fail "$1: the log does not say why"
}

try_unreadable_paths() {
    inside mkdir -p /home/pi
    refused 'device = "/home/pi/feed"'
    refused 'path = "/home/pi/street.map"'
    refused 'model = "/root/network.onnx"'
    refused 'require_signature_by = "/home/pi/owner.pub"' map
    refused 'journal = "/home/pi/events.jsonl"' telemetry
    refused 'signing_key = "/root/mavlink.key"' telemetry
    refused 'signing_clock = "/run/user/0/signing"' telemetry
    refused 'folder = "/home/pi/recordings"' recording
    step "eight paths below home folders: exit status 78, one line, no restart"
    write_config
    inside systemctl reset-failed lookback
    inside systemctl start lookback || fail "it does not start again"
}

try_doctor() {
    inside lookback doctor --offline /etc/lookback/lookback.toml >"$work/doctor.txt" || fail "doctor: $(cat "$work/doctor.txt")"
    grep -q "user lookback, groups video dialout plugdev" "$work/doctor.txt" || fail "doctor: $(cat "$work/doctor.txt")"
    inside chmod 0700 /var/lib/lookback/map
    inside chown root /var/lib/lookback/map
    inside lookback doctor --offline /etc/lookback/lookback.toml >"$work/doctor.txt" && fail "doctor sees with root's eyes"
    inside chown lookback /var/lib/lookback/map
    step "doctor, run by root: the rights of user lookback"
}

has_begun() { compgen -G "$root/opt/lookback.new.*/venv/bin/python" >/dev/null; }

try_updates() {
    local before
    inside systemctl disable --quiet lookback
    before=$(property MainPID)
    inside /srv/lookback/systemd/install.sh >"$work/update.txt" 2>&1 || fail "update: $(cat "$work/update.txt")"
    grep -q "with the extras page" "$work/update.txt" || fail "the page is lost: $(cat "$work/update.txt")"
    [ "$(inside systemctl is-enabled lookback || true)" = disabled ] || fail "the update enabled the service"
    [ "$(property MainPID)" != "$before" ] && is_active || fail "the update did not restart the service"
    step "update: restarted, still disabled, with its extras"
    inside systemctl enable --quiet lookback
    before=$(property MainPID)
    echo "not a wheel" >"$root/srv/lookback_nav-9.9-py3-none-any.whl"
    inside /srv/lookback/systemd/install.sh --wheel /srv/lookback_nav-9.9-py3-none-any.whl >/dev/null 2>&1 \
        && fail "a broken wheel was installed"
    [ "$(property MainPID)" = "$before" ] && is_active || fail "the failed update touched the service"
    [ "$(ls "$root/opt")" = lookback ] || fail "left in /opt: $(ls "$root/opt")"
    step "failed update: the old version runs on"
    inside /srv/lookback/systemd/install.sh >/dev/null 2>&1 &
    wait_for 300 has_begun || fail "the installation that is to be killed does not begin"
    inside pkill -KILL -f 'systemd/install\.sh|/opt/lookback\.new' || fail "the installation ended before it was killed"
    wait $! || true
    has_begun || fail "the killed installation left nothing"
    inside /srv/lookback/systemd/install.sh --wheel /srv/lookback_nav-9.9-py3-none-any.whl >/dev/null 2>&1 || true
    [ "$(ls "$root/opt")" = lookback ] || fail "left in /opt: $(ls "$root/opt")"
    step "killed update: the next run cleans up"
}

try_rollback() { # of a version that accepts the config, starts, and crashes after 15 s
    local before
    before=$(inside lookback --version)
    rm -rf "$root/srv/broken" && cp -r "$root/srv/lookback" "$root/srv/broken"
    sed -i '/^class Daemon/i import os, threading\nthreading.Timer(15, os._exit, [1]).start()\n' \
        "$root/srv/broken/edge/daemon.py"
    sed -i 's/^__version__ = .*/__version__ = "9.9"/' "$root/srv/broken/edge/__init__.py"
    inside /srv/broken/systemd/install.sh >"$work/rollback.txt" 2>&1 && fail "a version that crashes was installed"
    grep -q "so the old one is back" "$work/rollback.txt" || fail "rollback: $(tail -n 5 "$work/rollback.txt")"
    [ "$(inside lookback --version)" = "$before" ] || fail "after the rollback: $(inside lookback --version)"
    wait_for 60 is_active || fail "the old version does not run again"
    [ "$(ls "$root/opt")" = lookback ] || fail "left in /opt: $(ls "$root/opt")"
    step "rollback: a version that crashes is taken back, $before runs"
    rm -rf "$root/srv/broken"
}

what_is_left() { # of Lookback, but for what this script and systemd's journal have put there
    find "$root" -xdev \( -path "$root/srv" -o -path "$root/proc" -o -path "$root/sys" -o -path "$root/var/log" \
        -o -path "$root/tmp" -o -path "$root/root" \) -prune -o -iname '*lookback*' -print
    grep -s lookback "$root/etc/passwd" "$root/etc/group" || true
}

try_package_rollback() { # DEB: of a version that accepts the config, starts, and crashes after 15 s
    local broken=$work/broken before
    rm -rf "$broken"
    dpkg-deb --raw-extract "$1" "$broken"
    sed -i 's/^Version: .*/&+zbroken/' "$broken/DEBIAN/control"
    sed -i '/^class Daemon/i import os, threading\nthreading.Timer(15, os._exit, [1]).start()\n' \
        "$broken"/opt/lookback/lib/python3*/site-packages/edge/daemon.py
    find "$broken/opt" -path '*edge/__pycache__/daemon.*' -delete
    dpkg-deb --root-owner-group -Zgzip -z1 --build "$broken" "$root/srv/broken.deb" >/dev/null
    rm -rf "$broken"
    before=$(inside md5sum "$(find "$root/opt/lookback/lib" -path '*edge/daemon.py' | sed "s|^$root||")")
    inside dpkg --install /srv/broken.deb >"$work/deb.txt" 2>&1 </dev/null && fail "a package that crashes was installed"
    grep -q "so the old one is back" "$work/deb.txt" || fail "package's rollback: $(tail -n 5 "$work/deb.txt")"
    [ "$before" = "$(inside md5sum "${before#*  }")" ] || fail "the package that crashes is still there"
    wait_for 60 is_active || fail "the old version of the package does not run again"
    inside dpkg --install "/srv/$(basename "$1")" >"$work/deb.txt" 2>&1 </dev/null || fail "$(tail -n 5 "$work/deb.txt")"
    [ "$(ls "$root/opt")" = lookback ] || fail "left in /opt: $(ls "$root/opt")"
    step "package: a version that crashes is taken back"
}

try_package() {
    local deb=$root/srv/lookback.deb next
    cp "${DEB:-}" "$deb" 2>/dev/null || {
        step "building the package"
        inside /srv/lookback/systemd/build-deb.sh --maintainer 'Test <test@example.com>' -o /srv/deb >/dev/null 2>&1 || fail "build-deb.sh"
        mv "$root"/srv/deb/*.deb "$deb"
    }
    [ "$(stat --format=%s "$deb")" -lt 120000000 ] || fail "the package is larger than 120 MB: $(stat --format=%s "$deb")"
    inside dpkg --install /srv/lookback.deb >"$work/beside.txt" 2>&1 && fail "the package installs beside install.sh"
    grep -q "install.sh has installed it" "$work/beside.txt" || fail "refused without a reason: $(cat "$work/beside.txt")"
    inside /srv/lookback/systemd/install.sh --uninstall --purge >/dev/null
    inside dpkg --purge lookback >/dev/null 2>&1 || true
    left=$(what_is_left)
    [ -z "$left" ] || fail "left after --uninstall --purge: $left"
    step "install.sh --uninstall --purge: nothing is left; the package refused beside install.sh"
    inside unshare --net dpkg --install /srv/lookback.deb >"$work/deb.txt" 2>&1 </dev/null || fail "$(tail -n 5 "$work/deb.txt")"
    [ "$(inside systemctl is-enabled lookback)" = enabled ] || fail "the package did not enable the service"
    make_data
    write_config
    inside systemctl start lookback || fail "the package's service does not start"
    inside /srv/lookback/systemd/install.sh >"$work/beside.txt" 2>&1 && fail "install.sh installs beside the package"
    step "package: installed without a network, started, install.sh refuses beside it"
    next=$work/next
    rm -rf "$next"
    dpkg-deb --raw-extract "$deb" "$next"
    sed -i 's/^Version: .*/&+next/' "$next/DEBIAN/control"
    echo "# a new key" >>"$next/usr/share/doc/lookback/examples/lookback.toml"
    dpkg-deb --root-owner-group -Zgzip -z1 --build "$next" "$root/srv/next.deb" >/dev/null
    rm -rf "$next"
    inside systemctl disable --quiet lookback
    before=$(property MainPID) config=$(md5sum <"$root/etc/lookback/lookback.toml")
    inside dpkg --install /srv/next.deb >"$work/deb.txt" 2>&1 </dev/null || fail "upgrade: $(tail -n 5 "$work/deb.txt")"
    [ "$config" = "$(md5sum <"$root/etc/lookback/lookback.toml")" ] || fail "the upgrade changed the config"
    [ "$(property MainPID)" != "$before" ] && is_active || fail "the upgrade did not restart the service"
    [ "$(inside systemctl is-enabled lookback || true)" = disabled ] || fail "the upgrade enabled the service"
    step "package: upgraded without a question; config and disabled service as they were"
    try_package_rollback "$deb"
    inside dpkg --remove lookback >"$work/deb.txt" 2>&1 || fail "remove: $(tail -n 5 "$work/deb.txt")"
    inside dpkg --install /srv/lookback.deb >"$work/deb.txt" 2>&1 </dev/null || fail "again: $(tail -n 5 "$work/deb.txt")"
    [ "$config" = "$(md5sum <"$root/etc/lookback/lookback.toml")" ] || fail "removed and installed: the config is changed"
    inside systemctl start lookback && is_active || fail "removed and installed: it does not start"
    step "package: removed, and installed again with its config"
    inside systemctl enable --quiet lookback-camera.socket
    inside dpkg --purge lookback >"$work/deb.txt" 2>&1 || fail "purge: $(tail -n 5 "$work/deb.txt")"
    left=$(what_is_left)
    [ -z "$left" ] || fail "left after purge: $left"
    step "package: purged, nothing is left"
}

make_root
rm -rf "$root/srv/lookback" && mkdir -p "$root/srv/lookback"
tar -C "$here" -c pyproject.toml setup.py README.md LICENSE MANIFEST.in edge edge_plugins lookback lookback_fc6 sim systemd | tar -C "$root/srv/lookback" -x
boot
step "booted: $(inside systemctl --version | head -n 1)"
inside dpkg --purge lookback >/dev/null 2>&1 || true # what an earlier run that failed left here
inside /srv/lookback/systemd/install.sh --uninstall --purge >/dev/null
make_data
inside /srv/lookback/systemd/install.sh >"$work/install.txt" 2>&1 || fail "install.sh: $(tail -n 5 "$work/install.txt")"
[ "$(inside systemctl is-enabled lookback)" = enabled ] || fail "not enabled"
inside chown -R lookback:lookback /var/lib/lookback
step "installed as README says: $(inside lookback --version)"
write_config
inside chown root:lookback /etc/lookback/lookback.toml
inside systemctl start lookback || fail "it does not start"
wait_for 30 status_says "map" || fail "status: $(property StatusText)"
step "started; status: $(property StatusText)"
if [ "${ONLY:-}" != package ]; then
    try_doctor
    try_crash_and_hang
    try_slow_disk
    try_unreadable_paths
    try_missing_port_at_boot
    try_updates
    try_rollback
fi
try_package
step "all passed"
