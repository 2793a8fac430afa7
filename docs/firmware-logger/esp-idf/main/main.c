// Prints the raw readings of an MPU-6050 in the shape that undrift reads without a map, 100 times a second (ESP-IDF 5.2 or newer):
//   count:17,time(s):0.170012,gyro(count):-12,34,5,accel(count):120,-88,16320,temp(C):25.31
// Set the pins below. Another part: change the registers, the scale of the temperature and, if need be, the byte order.
// SPDX-License-Identifier: MIT
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>

#include "driver/i2c_master.h"
#include "esp_err.h"
#include "esp_timer.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"

#define SDA 21
#define SCL 22
#define IMU 0x68
#define PERIOD_MS 10
#define WAIT_MS 5

static i2c_master_dev_handle_t imu;

static void set(uint8_t reg, uint8_t value) {
    const uint8_t bytes[2] = {reg, value};
    ESP_ERROR_CHECK(i2c_master_transmit(imu, bytes, sizeof bytes, WAIT_MS));
}

static int16_t word(const uint8_t *bytes) {
    return (int16_t)((uint16_t)bytes[0] << 8 | bytes[1]);
}

void app_main(void) {
    const i2c_master_bus_config_t bus_config = {
        .i2c_port = I2C_NUM_0,
        .sda_io_num = SDA,
        .scl_io_num = SCL,
        .clk_source = I2C_CLK_SRC_DEFAULT,
        .glitch_ignore_cnt = 7,
        .flags.enable_internal_pullup = true,
    };
    const i2c_device_config_t imu_config = {
        .dev_addr_length = I2C_ADDR_BIT_LEN_7, .device_address = IMU, .scl_speed_hz = 400000};
    i2c_master_bus_handle_t bus;
    ESP_ERROR_CHECK(i2c_new_master_bus(&bus_config, &bus));
    ESP_ERROR_CHECK(i2c_master_bus_add_device(bus, &imu_config, &imu));
    set(0x6B, 0x01);  // awake, clock of the gyroscope
    set(0x1A, 0x03);  // low-pass filter of 42 Hz
    set(0x1B, 0x00);  // +-250 deg/s: 131 counts per deg/s
    set(0x1C, 0x00);  // +-2 g: 16384 counts per g

    TickType_t woken = xTaskGetTickCount();
    for (uint32_t count = 0;; count++) {
        vTaskDelayUntil(&woken, pdMS_TO_TICKS(PERIOD_MS));
        const int64_t us = esp_timer_get_time();
        const uint8_t reg = 0x3B;
        uint8_t b[14];  // accelerometers, temperature, gyroscopes: high byte first
        if (i2c_master_transmit_receive(imu, &reg, 1, b, sizeof b, WAIT_MS) != ESP_OK) {
            continue;  // a number is missing: undrift marks a gap
        }
        printf("count:%" PRIu32 ",time(s):%" PRId64 ".%06d,gyro(count):%d,%d,%d,accel(count):%d,%d,%d,temp(C):%.2f\n", count,
               us / 1000000, (int)(us % 1000000), word(b + 8), word(b + 10), word(b + 12), word(b), word(b + 2), word(b + 4),
               word(b + 6) / 340.0 + 36.53);
    }
}
