#!/bin/sh
# First process of the test machine. Its root is the host's file system, read-only.
#
# This script lies in the machine's own directory. The machine can write only to this directory and to the output
# directory. The directory contains two more scripts. `mounts` mounts again the directories that the mounts here hide,
# and mounts the output directory. `command` is the command to run; its exit status goes to the file `status`. A failed
# step of the boot goes to the file `failed` instead. On the console, a mark precedes and follows the command's output.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
control=${0%/*}
mark=${control##*/}

power_off() {
    echo o >/proc/sysrq-trigger
    while :; do sleep 1; done
}

step() {
    "$@" && return
    echo "$*" >"$control/failed"
    power_off
}

# Calls finit_module. A Debian system may lack kmod, but always has perl.
load() {
    perl -e '
        open(my $module, "<", $ARGV[0]) or die "$ARGV[0]: $!\n";
        my $parameters = "";
        syscall(313, fileno($module), $parameters, 0) == 0 or die "$ARGV[0]: $!\n";
    ' "/usr/lib/uml/modules/$(uname -r)/kernel/$1.ko"
}

mount -t proc proc /proc
echo 1 >/proc/sys/kernel/printk
mount -t sysfs sysfs /sys
stty -opost -echo </dev/console
mkdir /dev/pts /dev/shm
mount -t devpts devpts /dev/pts
# `mounts` is read before the mounts below hide the file. The machine's directory is mounted last, since the directory
# may lie inside one of these mounts.
mounts=$(cat "$control/mounts")
for directory in /dev/shm /run /tmp /var/tmp; do
    mount -t tmpfs tmpfs "$directory"
done
unseen=$(sh -ec "$mounts" 2>&1)
mkdir -p "$control"
mount -t hostfs -o "rw,$control" none "$control" || power_off
[ -z "$unseen" ] || step false "$unseen"

step load net/can/can
step load net/can/can-raw
step load net/can/can-bcm
step load drivers/net/can/dev/can-dev
step load drivers/net/can/vcan
step load drivers/net/can/slcan/slcan
step load net/sched/sch_tbf
step ip link set lo up
step ip link add dev vcan0 type vcan
step ip link set vcan0 mtu 16 up

echo "$mark"
setsid --wait /bin/sh "$control/command" </dev/null
echo $? >"$control/status"
echo "$mark"
power_off
