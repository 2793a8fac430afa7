// Prints the raw readings of an MPU-6050 in the shape that undrift reads without a map, 100 times a second:
//   count:17,time(s):0.170012,gyro(count):-12,34,5,accel(count):120,-88,16320,temp(C):25.31
// The board's overlay names the bus (app.overlay). Another part: change the registers, the scale of the temperature and, if need be,
// the byte order.
// SPDX-License-Identifier: MIT
#include <stdint.h>
#include <stdlib.h>

#include <zephyr/drivers/i2c.h>
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

#define PERIOD_MS 10

static const struct i2c_dt_spec imu = I2C_DT_SPEC_GET(DT_NODELABEL(imu));
K_TIMER_DEFINE(period, NULL, NULL);

static int word(const uint8_t *bytes) {
    return (int16_t)((uint16_t)bytes[0] << 8 | bytes[1]);
}

int main(void) {
    if (!i2c_is_ready_dt(&imu) || i2c_reg_write_byte_dt(&imu, 0x6B, 0x01)  // awake, clock of the gyroscope
        || i2c_reg_write_byte_dt(&imu, 0x1A, 0x03)                         // low-pass filter of 42 Hz
        || i2c_reg_write_byte_dt(&imu, 0x1B, 0x00)                         // +-250 deg/s: 131 counts per deg/s
        || i2c_reg_write_byte_dt(&imu, 0x1C, 0x00)) {                      // +-2 g: 16384 counts per g
        printk("no MPU-6050 at this address\n");
        return 0;
    }
    k_timer_start(&period, K_MSEC(PERIOD_MS), K_MSEC(PERIOD_MS));
    for (uint32_t count = 0;;) {
        count += k_timer_status_sync(&period);  // more than 1 where one was missed: undrift marks a gap
        const uint64_t us = k_ticks_to_us_floor64(k_uptime_ticks());
        uint8_t b[14];  // accelerometers, temperature, gyroscopes: high byte first
        if (i2c_burst_read_dt(&imu, 0x3B, b, sizeof b)) {
            continue;
        }
        const int centi = word(b + 6) * 5 / 17 + 3653;  // 0.01 degC: raw / 340 + 36.53
        printk("count:%u,time(s):%u.%06u,gyro(count):%d,%d,%d,accel(count):%d,%d,%d,temp(C):%s%d.%02d\n", count,
               (unsigned int)(us / 1000000), (unsigned int)(us % 1000000), word(b + 8), word(b + 10), word(b + 12), word(b),
               word(b + 2), word(b + 4), centi < 0 ? "-" : "", abs(centi) / 100, abs(centi) % 100);
    }
}
