"""What installs, uninstalls, restarts and fences a bundle on its host: POSIX shell that is given nothing to interpret.

Names and paths stand in single quotes at the top and in double quotes where they are used; what they may be made of is
checked when the fleet file is read (`names`). With DESTDIR everything goes below that folder, and accounts and services
are left alone, as packagers expect it.
"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from swarmabs_fleet.places import UNIT_FOLDER, WIREGUARD_FOLDER, state_folder, target_name
from swarmabs_fleet.wireguard import FENCE, heading

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_config.fleet.model import Fleet

_HEAD = """\
#!/bin/sh
# @PURPOSE@
set -eu
umask 077
fleet=@FLEET@
host=@HOST@
prefix=@PREFIX@
user=@USER@
checkout=@CHECKOUT@
ros=@ROS@
setup=@SETUP@
target=@TARGET@
tunnel=@TUNNEL@
root=${DESTDIR:-}
unset CDPATH
here=$(cd -- "$(dirname -- "$0")" && pwd -P)
installed=$root$prefix/$fleet
unit_folder=$root@UNIT_FOLDER@
wireguard_folder=@WIREGUARD_FOLDER@
tunnel_file=$root$wireguard_folder/$tunnel.conf
tunnel_heading=@TUNNEL_HEADING@

fail() {
    printf '%s: %s\\n' "${0##*/}" "$1" >&2
    exit 1
}

as_root() {
    [ -n "$root" ] || [ "$(id -u)" = 0 ] || fail "this needs root; start it with sudo"
    [ -n "$root" ] || command -v systemctl >/dev/null || fail "there is no systemctl; this host needs systemd"
}

# Says whether a file is a tunnel's configuration that this fleet has made.
own_tunnel() {
    [ "$(head -n 1 -- "$1")" = "$tunnel_heading" ]
}

# Says whether a folder holds a bundle of this fleet, whole or not.
own_bundle() {
    [ -f "$1/manifest.json" ] && grep -qxF -- "  \\"fleet\\": \\"$fleet\\"," "$1/manifest.json"
}

# Refuses to touch what stands in the place of a bundle and is none of this fleet; an empty folder is nobody's.
only_own() {
    if [ -e "$1" ] || [ -L "$1" ]; then
        own_bundle "$1" || { [ -d "$1" ] && [ ! -L "$1" ] && [ -z "$(ls -A -- "$1")" ]; } ||
            fail "$1 is no bundle of $fleet, so it stays as it is; move it away, or change name or installation.prefix"
    fi
}

# Removes a bundle; that it is one can be seen as long as anything of it is there.
remove_bundle() {
    for entry in "$1"/* "$1"/.[!.]*; do
        [ "${entry##*/}" = manifest.json ] || rm -rf -- "$entry"
    done
    rm -rf -- "$1"
}

# Prints the interfaces of the tunnels that the installed bundle has.
installed_tunnels() {
    [ ! -f "$installed/manifest.json" ] ||
        sed -n 's|^    "wireguard/\\([A-Za-z0-9_.-]*\\)\\.conf": {$|\\1|p' "$installed/manifest.json"
}

# Ends a tunnel of the installed bundle, which takes the installed fence down, and removes its configuration.
remove_tunnel() {
    file=$root$wireguard_folder/$1.conf
    if [ -e "$file" ] && own_tunnel "$file"; then
        [ -n "$root" ] || systemctl disable --now -- "wg-quick@$1.service" || :
        rm -f -- "$file"
    fi
}
"""

_INSTALL = """
# Prints what a tunnel's configuration says of the host itself.
own_part() {
    sed '/^$/,$d' -- "$1"
}

# Prints what a fence.sh keeps others from.
fenced() {
    sed -n '/^address=/p;/^interface=/p' -- "$1"
}

# Says whether the fence of the installed bundle is up.
fence_is_up() {
    command -v ip >/dev/null || return 1
    of=$(sed -n 's/^  "address": "\\([0-9.]*\\)",$/\\1/p' "$installed/manifest.json")
    [ -n "$of" ] && [ -n "$(ip -4 rule show pref 3 to "$of")" ]
}

# Makes a folder that everybody may enter, and those on the way to it.
make_folder() {
    (umask 022 && mkdir -p -- "$1")
}

# Says whether the prefix is a folder that earlier versions of this script have made for themselves alone.
closed_prefix() {
    [ "$(stat -c %a -- "$root$prefix" 2>/dev/null)" = 700 ] || return 1
    for entry in "$root$prefix"/* "$root$prefix"/.[!.]*; do
        [ ! -e "$entry" ] || [ -f "$entry/manifest.json" ] || return 1
    done
}

# Starts a command as the account of the nodes; where that cannot be done, it is not started.
as_user() {
    ! command -v setpriv >/dev/null ||
        setpriv --reuid "$user" --regid "$(id -g -- "$user")" --init-groups -- "$@"
}

# Everything is looked at before anything is changed.
as_root
[ "$here" != "$installed" ] || fail "this is the installed copy; start install.sh of the bundle"
cd -- "$here"
[ -f SHA256SUMS ] && [ -f manifest.json ] || fail "the bundle is not complete; copy it again"
sha256sum --check --quiet --strict SHA256SUMS >&2 || fail "the bundle is damaged or not complete; copy it again"
if [ "$ros" = wheels ]; then
    [ -x "$checkout/.venv/bin/python" ] || fail "$checkout is not prepared; start there: ./scripts/swarm doctor"
else
    [ -r "$setup" ] || fail "$setup is missing; install ROS 2 Jazzy, or correct installation.setup in the fleet file"
fi
[ -x "$checkout/scripts/swarm" ] || fail "there is no $checkout/scripts/swarm; put the checkout there"
if [ -z "$root" ]; then
    id -- "$user" >/dev/null 2>&1 ||
        fail "there is no account $user; make one: useradd --system --shell /usr/sbin/nologin $user"
fi
if [ -n "$tunnel" ]; then
    [ -n "$root" ] || command -v wg-quick >/dev/null || fail "there is no wg-quick; install wireguard-tools"
    [ ! -e "$tunnel_file" ] || own_tunnel "$tunnel_file" ||
        fail "$tunnel_file is not of this fleet; name another security.interface in the fleet file"
fi
new=$installed.new
old=$installed.old
for folder in "$installed" "$new" "$old"; do
    only_own "$folder"
done

trap 'remove_bundle "$new"' EXIT
trap 'exit 1' HUP INT TERM
make_folder "$root$prefix"
make_folder "$unit_folder"
! closed_prefix || chmod 755 "$root$prefix"
# An earlier start of this script was interrupted between two renamings.
if [ -e "$old" ] && [ ! -e "$installed" ]; then
    mv -- "$old" "$installed"
fi
remove_bundle "$new"
remove_bundle "$old"

# Only what the list names is copied, with modes of its own whatever has become of them on the way here.
mkdir -- "$new"
cp -- manifest.json "$new/"
while read -r _ path; do
    mkdir -p -- "$new/$(dirname -- "$path")"
    cp -- "$path" "$new/$path"
done <SHA256SUMS
cp -- SHA256SUMS "$new/"
find "$new" -type d -exec chmod 755 {} +
find "$new" -type f -exec chmod 644 {} +
chmod 755 "$new/install.sh" "$new/uninstall.sh" "$new/restart.sh" "$new/fence.sh"
for secret in keystore wireguard; do
    [ -d "$new/$secret" ] || continue
    find "$new/$secret" -type d -exec chmod 700 {} +
    find "$new/$secret" -type f -exec chmod 600 {} +
done
if [ -d "$new/keystore" ] && [ -z "$root" ]; then
    chown -R -- "$user:" "$new/keystore"
fi
if [ -z "$root" ]; then
    as_user test -r "$new/units.txt" ||
        fail "$user cannot enter $prefix; let others enter it and what it is in (chmod o+x), or name another prefix"
fi

# The environment of ROS 2 on this host, asked for without anything of whoever installs.
clean='env -i HOME=/ LANG=C.UTF-8 PATH=/usr/local/bin:/usr/bin:/bin'
if [ "$ros" = wheels ]; then
    $clean "$checkout/scripts/swarm" env >"$new/workspace.raw"
else
    $clean SWARMABS_USE_SOURCED_ROS=1 sh -c '. "$1" && exec "$2/scripts/swarm" env' sh "$setup" "$checkout" \\
        >"$new/workspace.raw"
fi || fail "$checkout is not ready; start there: ./scripts/swarm doctor"
sed -n 's/^export //p' "$new/workspace.raw" >"$new/workspace.env"
rm -- "$new/workspace.raw"
grep -q '^PYTHONPATH=' "$new/workspace.env" || fail "$checkout has no environment; start there: ./scripts/swarm doctor"
chmod 644 "$new/workspace.env"

# Units that this fleet had on this host and has no more.
if [ -f "$installed/units.txt" ]; then
    while read -r unit; do
        grep -qxF -- "$unit" "$new/units.txt" && continue
        [ -n "$root" ] || systemctl disable --now -- "$unit" || :
        rm -f -- "$unit_folder/$unit"
    done <"$installed/units.txt"
fi
# What is up of the tunnel and the fence as they were is ended with the files that have started it. One that stays and
# is up must learn who belongs to it and who no longer does; only its own part needs a new beginning.
tunnel_verb=start
fence_verb=
for name in $(installed_tunnels); do
    [ "$name" = "$tunnel" ] || remove_tunnel "$name"
done
if [ -n "$tunnel" ] && [ -e "$tunnel_file" ] && ! cmp -s -- "$new/wireguard/$tunnel.conf" "$tunnel_file"; then
    tunnel_verb=reload-or-restart
    if [ "$(own_part "$new/wireguard/$tunnel.conf")" != "$(own_part "$tunnel_file")" ]; then
        tunnel_verb=start
        [ -n "$root" ] || systemctl stop -- "wg-quick@$tunnel.service" || :
    fi
fi
if [ -z "$root" ] && [ -x "$installed/fence.sh" ] &&
    [ "$(fenced "$installed/fence.sh")" != "$(fenced "$new/fence.sh")" ]; then
    [ -n "$tunnel" ] || ! fence_is_up || fence_verb=up
    "$installed/fence.sh" down || :
fi

[ ! -e "$installed" ] || mv -- "$installed" "$old"
mv -- "$new" "$installed"
remove_bundle "$old"
while read -r unit; do
    cp -- "$installed/systemd/$unit" "$unit_folder/.$unit.new"
    chmod 644 "$unit_folder/.$unit.new"
    mv -- "$unit_folder/.$unit.new" "$unit_folder/$unit"
done <"$installed/units.txt"
if [ -n "$tunnel" ]; then
    mkdir -p -- "${tunnel_file%/*}"
    cp -- "$installed/wireguard/$tunnel.conf" "$tunnel_file.new"
    chmod 600 "$tunnel_file.new"
    mv -- "$tunnel_file.new" "$tunnel_file"
fi
if [ -z "$root" ]; then
    systemctl daemon-reload
    if [ -n "$tunnel" ]; then
        systemctl enable -- "wg-quick@$tunnel.service"
        systemctl "$tunnel_verb" -- "wg-quick@$tunnel.service"
    fi
    systemctl enable -- "$target"
    [ -z "$fence_verb" ] || "$installed/fence.sh" "$fence_verb"
fi
: >"$installed/complete"
chmod 644 "$installed/complete"
printf 'installed the bundle of %s in %s\\n' "$host" "$installed"
printf 'start it with: systemctl start %s; a running one takes it over with: %s/restart.sh\\n' "$target" "$installed"
"""

_UNINSTALL = """
as_root
[ -d "$installed" ] || fail "$installed is not there; nothing is installed"
for folder in "$installed" "$installed.new" "$installed.old"; do
    only_own "$folder"
done
units=
[ ! -f "$installed/units.txt" ] || units=$(cat -- "$installed/units.txt")
[ -n "$root" ] || systemctl disable --now -- "$target" || :
for unit in $units; do
    [ -n "$root" ] || systemctl disable --now -- "$unit" || :
    rm -f -- "$unit_folder/$unit"
done
for name in $(installed_tunnels); do
    remove_tunnel "$name"
done
[ -n "$root" ] || systemctl daemon-reload
[ -n "$root" ] || [ ! -x "$installed/fence.sh" ] || "$installed/fence.sh" down || :
cd /
for folder in "$installed.new" "$installed.old" "$installed"; do
    remove_bundle "$folder"
done
rmdir -- "$root$prefix" 2>/dev/null || :
printf 'uninstalled the bundle of %s; recordings stay in %s\\n' "$host" @STATE@
"""

_RESTART = """
# One node after the other: the next one only when the one before says that it is ready.
as_root
[ -z "$root" ] || fail "there is nothing to restart below DESTDIR"
[ -f "$installed/complete" ] || fail "the installation in $installed is not complete; start install.sh again"
while read -r unit; do
    [ "$unit" != "$target" ] || continue
    printf 'restarting %s\\n' "$unit"
    systemctl restart -- "$unit" || fail "$unit does not start; see: journalctl -u $unit"
    systemctl is-active --quiet -- "$unit" || fail "$unit has ended; see: journalctl -u $unit"
done <"$installed/units.txt"
systemctl start -- "$target"
printf 'all nodes of %s are running\\n' "$host"
"""

_FENCE = """
# Linux takes a packet for any of its addresses by any of its interfaces. The fence drops what comes for the fleet's
# address by another one. The rules of other fleets stay as they are; it may be started again at any time.
address=@ADDRESS@
interface=@INTERFACE@

put_up() {
    [ -n "$(ip -4 rule show pref 1 iif lo to "$address")" ] ||
        ip -4 rule add pref 1 iif lo to "$address" lookup local
    [ -n "$(ip -4 rule show pref 2 iif "$interface" to "$address")" ] ||
        ip -4 rule add pref 2 iif "$interface" to "$address" lookup local
    [ -n "$(ip -4 rule show pref 3 to "$address")" ] ||
        ip -4 rule add pref 3 to "$address" blackhole
    # The table of the host's own addresses, which comes first by itself, moves behind these rules.
    [ -n "$(ip -4 rule show pref 4 table local)" ] || ip -4 rule add pref 4 lookup local
    [ -z "$(ip -4 rule show pref 0 table local)" ] || ip -4 rule delete pref 0 lookup local
}

take_down() {
    for rule in "1 iif lo" "2 iif $interface" 3; do
        # shellcheck disable=SC2086 # of several words
        [ -z "$(ip -4 rule show pref $rule to "$address")" ] || ip -4 rule delete pref $rule to "$address"
    done
    if [ -z "$(ip -4 rule show pref 3)" ]; then
        [ -n "$(ip -4 rule show pref 0 table local)" ] || ip -4 rule add pref 0 lookup local
        [ -z "$(ip -4 rule show pref 4 table local)" ] || ip -4 rule delete pref 4 lookup local
    fi
}

[ "$(id -u)" = 0 ] || fail "this needs root; start it with sudo"
command -v ip >/dev/null || fail "there is no ip; install iproute2"
case ${1:-} in
    up) put_up ;;
    down) take_down ;;
    *) fail "say up or down" ;;
esac
"""


def scripts(fleet: Fleet, host: str) -> dict[str, str]:
    """Return the scripts of a host's bundle by name."""
    return {
        "install.sh": _script(fleet, host, "Installs this host's bundle; starts nothing.", _INSTALL),
        "uninstall.sh": _script(fleet, host, "Stops and removes what install.sh has installed.", _UNINSTALL),
        "restart.sh": _script(fleet, host, "Restarts this host's nodes one by one.", _RESTART),
        FENCE: _script(fleet, host, "Keeps others away from this host's address in the fleet: up or down.", _FENCE),
    }


def checksums(sums: Sequence[tuple[str, str]]) -> str:
    """Return the list of files and their SHA-256 as ``sha256sum --check`` reads it."""
    return "".join(f"{digest}  {path}\n" for path, digest in sums)


def _script(fleet: Fleet, host: str, purpose: str, body: str) -> str:
    values = {
        "FLEET": fleet.name,
        "HOST": host,
        "PREFIX": fleet.installation.prefix,
        "USER": fleet.user(host),
        "CHECKOUT": fleet.installation.checkout,
        "ROS": fleet.ros(host),
        "SETUP": fleet.installation.setup,
        "TARGET": target_name(fleet),
        "TUNNEL": fleet.tunnel.interface if fleet.tunnel else "",
        "ADDRESS": fleet.address(host),
        "INTERFACE": fleet.interface(host),
        "TUNNEL_HEADING": heading(fleet),
        "STATE": f"/var/lib/{state_folder(fleet)}",
        "UNIT_FOLDER": UNIT_FOLDER,
        "WIREGUARD_FOLDER": WIREGUARD_FOLDER,
    }
    text = (_HEAD + body).replace("@PURPOSE@", f"{purpose} Fleet {fleet.name}, host {host}.")
    for name, value in values.items():
        text = text.replace(f"@{name}@", shlex.quote(value))
    return text
