#!/busybox sh
# First process of the test machine, in a file system of its own. The file system contains this script, BusyBox, the
# modules in the order of loading, and three more scripts. `settings` names the machine's own directory. `mounts` mounts
# again the directories that the mounts here hide, and mounts the output directory. `command` is the command to run.
#
# The output of the command goes to hvc0, messages of this script and of the kernel to the console. The file `began`
# marks the end of the boot; the command's exit status goes to `status`.
export PATH=/bin
/busybox mkdir -p /bin /dev /host /proc /root /sys
/busybox --install -s /bin
. /settings

power_off() {
    echo o >/proc/sysrq-trigger
    while :; do sleep 1; done
}

step() {
    "$@" && return
    echo "the boot failed at: $*"
    power_off
}

mount -t proc proc /proc
mount -t sysfs sysfs /sys
step mount -t devtmpfs dev /dev
for module in /*.ko; do step insmod "$module"; done
ip link set lo up
step ip link add dev vcan0 type vcan
step ip link set vcan0 up

step mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=262144 host /host
step mount -o bind /host /root
mount -t proc proc /root/proc
mount -t sysfs sysfs /root/sys
mount -t devtmpfs dev /root/dev
mkdir -p /dev/pts /dev/shm
mount -t devpts devpts /root/dev/pts
for directory in /dev/shm /run /tmp /var/tmp; do
    step mount -t tmpfs tmpfs "/root$directory"
done
step sh -e /mounts
mkdir -p "/root$control"
step mount -t 9p -o trans=virtio,version=9p2000.L,rw,msize=262144 control "/root$control"

# Kept open: the settings of the terminal are lost when its last user closes the terminal.
exec 3<>/dev/hvc0
step stty -F /dev/hvc0 -opost -echo
step touch "/root$control/began"
setsid chroot /root /bin/sh -c "$(cat /command)" </dev/null >/dev/hvc0 2>&1 3>&-
status=$?
# Waits until the whole output is written.
stty -F /dev/hvc0 -opost
echo $status >"/root$control/status"
power_off
