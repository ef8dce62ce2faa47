#!/bin/busybox sh
# First program of the guest: what the flights need of a system, the flights, power off.
/bin/busybox mkdir -p /proc /sys /dev /tmp /run /root
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
exec </dev/null >/dev/ttyS0 2>&1
mkdir -p /dev/shm /dev/pts
mount -t tmpfs shm /dev/shm
while read -r module; do insmod "$module" || echo "init: $module not loaded"; done </modules
/sbin/ip link set lo up
/sbin/ip link add vcan0 type vcan && /sbin/ip link set vcan0 up || echo "init: no vcan0"
. /settings
cd "$ROOT" && LD_PRELOAD=/dilate.so "$PYTHON" -m tests.kernel.flights
echo "init: flights ended with $?"
poweroff -f
