# Two CAN cards on one wire, of which the daemon has can0 and the rig can1; a CAN of the kernel's own; an I2C bus.
# What is there already stays.
modprobe -a kvaser_pci can-raw vcan i2c-dev
modprobe i2c-stub chip_addr=0x76
udevadm settle
for card in can0 can1; do
  ip link set "$card" down
  ip link set "$card" type can bitrate 1000000 restart-ms 100
  ip link set "$card" txqueuelen 1000 up
done
ip link show vcan0 >/dev/null 2>&1 || ip link add vcan0 type vcan
ip link set vcan0 up
