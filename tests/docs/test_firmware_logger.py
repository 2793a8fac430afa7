"""The sketches of docs/firmware-logger: each compiles without a warning, runs, and prints what undrift reads without a map."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from testkit.printing_board import sketch_line
from undrift.io.formats import read_counted
from undrift.io.inspect import describe

ROOT = Path(__file__).parents[2]
LOGGER = ROOT / "docs" / "firmware-logger"
STUBS = '#include "firmware_stubs.h"\n'
STRICT = ("-Wall", "-Wextra", "-Werror", "-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all")
ARDUINO = """
#include <type_traits>
struct SerialStub {
    void begin(long) {}
    void print(const char *text) { fputs(text, stdout); }
    void print(char letter) { putchar(letter); }
    template <typename Number> typename std::enable_if<std::is_integral<Number>::value>::type print(Number value) {
        printf("%lld", (long long)value);
    }
    void println(double value, int digits) { printf("%.*f\\r\\n", digits, value); }
};
static SerialStub Serial;
static inline uint32_t micros() { return (uint32_t)(clock_us += 100); }
"""
WIRE = """
struct WireStub {
    uint8_t reg = 0, bytes[14];
    int sent = 0, at = 0;
    void begin() {}
    void setClock(long) {}
    void beginTransmission(uint8_t) { sent = 0; }
    void write(uint8_t value) { if (sent++) written[reg] = value; else reg = value; }
    void endTransmission(bool = true) {}
    uint8_t requestFrom(uint8_t, uint8_t size) { burst(reg, bytes, size); at = 0; return size; }
    int read() { return bytes[at++]; }
};
static WireStub Wire;
"""
ESP_I2C = """
typedef int esp_err_t;
enum { ESP_OK, I2C_NUM_0 = 0, I2C_CLK_SRC_DEFAULT = 0, I2C_ADDR_BIT_LEN_7 = 0 };
#define ESP_ERROR_CHECK(call) do { if ((call) != ESP_OK) exit(4); } while (0)
typedef void *i2c_master_bus_handle_t;
typedef void *i2c_master_dev_handle_t;
typedef struct {
    int i2c_port, sda_io_num, scl_io_num, clk_source, glitch_ignore_cnt;
    struct { bool enable_internal_pullup; } flags;
} i2c_master_bus_config_t;
typedef struct { int dev_addr_length, device_address, scl_speed_hz; } i2c_device_config_t;
static inline esp_err_t i2c_new_master_bus(const i2c_master_bus_config_t *config, i2c_master_bus_handle_t *bus) {
    return *bus = (void *)config, ESP_OK;
}
static inline esp_err_t i2c_master_bus_add_device(i2c_master_bus_handle_t bus, const i2c_device_config_t *config,
                                                  i2c_master_dev_handle_t *device) {
    return *device = bus, config->device_address == 0x68 ? ESP_OK : 1;
}
static inline esp_err_t i2c_master_transmit(i2c_master_dev_handle_t device, const uint8_t *bytes, size_t size, int wait_ms) {
    return written[bytes[0]] = bytes[1], device && size == 2 && wait_ms > 0 ? ESP_OK : 1;
}
static inline esp_err_t i2c_master_transmit_receive(i2c_master_dev_handle_t device, const uint8_t *reg, size_t one,
                                                    uint8_t *bytes, size_t size, int wait_ms) {
    return burst(*reg, bytes, size), device && one == 1 && wait_ms > 0 ? ESP_OK : 1;
}
"""
ESP_TASK = """
typedef uint32_t TickType_t;
#define pdMS_TO_TICKS(ms) ((ms) / 10)
static inline TickType_t xTaskGetTickCount(void) { return (TickType_t)(clock_us / 10000); }
static inline void vTaskDelayUntil(TickType_t *woken, TickType_t ticks) { *woken += ticks; clock_us = (int64_t)*woken * 10000; }
"""
ZEPHYR_I2C = """
struct i2c_dt_spec { int address; };
#define DT_NODELABEL(name) 0x68
#define I2C_DT_SPEC_GET(node) { node }
static inline bool i2c_is_ready_dt(const struct i2c_dt_spec *spec) { return spec->address == 0x68; }
static inline int i2c_reg_write_byte_dt(const struct i2c_dt_spec *spec, uint8_t reg, uint8_t value) {
    return written[reg] = value, spec->address != 0x68;
}
static inline int i2c_burst_read_dt(const struct i2c_dt_spec *spec, uint8_t reg, uint8_t *bytes, uint32_t size) {
    return burst(reg, bytes, size), spec->address != 0x68;
}
"""
ZEPHYR_KERNEL = """
struct k_timer { int64_t due; };
#define K_TIMER_DEFINE(name, expired, stopped) static struct k_timer name
#define K_MSEC(ms) ((ms) * 1000)
static inline void k_timer_start(struct k_timer *timer, int64_t first_us, int64_t period_us) {
    timer->due = clock_us + first_us + 0 * period_us;
}
static inline uint32_t k_timer_status_sync(struct k_timer *timer) { clock_us = timer->due; timer->due += 10000; return 1; }
static inline int64_t k_uptime_ticks(void) { return clock_us; }
static inline uint64_t k_ticks_to_us_floor64(uint64_t ticks) { return ticks; }
"""
HEADERS = {
    "arduino-logger/arduino-logger.ino": {"Arduino.h": ARDUINO, "Wire.h": WIRE},
    "esp-idf/main/main.c": {
        "driver/i2c_master.h": ESP_I2C,
        "esp_err.h": "",
        "esp_timer.h": "static inline int64_t esp_timer_get_time(void) { return clock_us; }\n",
        "freertos/FreeRTOS.h": "",
        "freertos/task.h": ESP_TASK,
    },
    "zephyr/src/main.c": {
        "zephyr/drivers/i2c.h": ZEPHYR_I2C,
        "zephyr/kernel.h": ZEPHYR_KERNEL,
        "zephyr/sys/printk.h": "#define printk printf\n",
    },
}
MAINS = {
    ".ino": "int main() { setup(); for (;;) loop(); }\n",
    "esp-idf/main/main.c": "int main(void) { app_main(); }\n",
}


@pytest.mark.skipif(shutil.which("g++") is None, reason="a compiler of C and C++")
@pytest.mark.parametrize("name", HEADERS)
def test_a_sketch_prints_what_needs_no_map(name: str, tmp_path: Path):
    for header, text in HEADERS[name].items():
        path = tmp_path / header
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("#pragma once\n" + STUBS + text)
    cpp = name.endswith(".ino")
    main = next((text for end, text in MAINS.items() if name.endswith(end)), "")
    source = tmp_path / f"main.{'cpp' if cpp else 'c'}"
    source.write_text((LOGGER / name).read_text() + main)
    words = ["g++" if cpp else "gcc", f"-std={'c++11' if cpp else 'c11'}", *STRICT, f"-I{tmp_path}"]
    subprocess.run([*words, f"-I{ROOT / 'tests' / 'testkit'}", source, "-o", tmp_path / "run"], check=True, timeout=120)
    done = subprocess.run([tmp_path / "run"], capture_output=True, timeout=60, check=False)
    assert done.returncode == 0, (done.returncode, done.stdout[-300:], done.stderr[-300:])
    log = tmp_path / "monitor.txt"
    log.write_bytes(b"boot: 7 devices\r\n" + done.stdout)
    assert describe(log).kind == "recording"
    read = read_counted(log)
    record = read.record
    assert (len(record), read.dropped_rows) == (300, 0)
    assert (record.gyro_unit, record.accel_unit) == ("count", "count")
    np.testing.assert_allclose(np.diff(record.time), 0.01, atol=2e-4)
    np.testing.assert_allclose(np.mean(record.gyro, axis=0), (-120.0, 60.0, 30.0), atol=0.1)
    np.testing.assert_allclose(np.mean(record.accel, axis=0), (150.0, -90.0, 16300.0), atol=0.1)
    np.testing.assert_allclose(record.temp_c, 25.0, atol=0.02)
    shape = re.sub(rb"-?\d+(\.\d+)?", b"N", sketch_line(1, 1, np.zeros(3), np.zeros(3), 25.0)).rstrip()
    assert {re.sub(rb"-?\d+(\.\d+)?", b"N", line).rstrip() for line in done.stdout.splitlines()} == {shape}
    assert max(map(len, done.stdout.splitlines())) < 100
