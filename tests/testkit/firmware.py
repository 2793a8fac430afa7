"""Output of firmware on a serial port, as in the public examples of makers and libraries: forty formats of the same
motion.

Each shape is a function of the true readings that writes text; what it states (units, names, time) is what the example states. A
device lies for five seconds, is turned about its axes and lies on another face. Gyroscopes come in rad/s, accelerometers in m/s2.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

G = 9.80665
DEGREE = np.pi / 180.0
RATE_HZ = 100.0


@dataclass(frozen=True)
class Motion:
    """True readings: time (N,) s, gyro (N, 3) rad/s, accel (N, 3) m/s2, temp (N,) degC."""

    time: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    temp: np.ndarray


@cache
def motion(seconds: float = 20.0) -> Motion:
    """Return a rest of five seconds, turns about each axis by what gravity shows, and noise of a usual part."""
    rng = np.random.default_rng(19)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    rate = np.zeros((len(time), 3))
    for axis, start in ((0, 5.0), (1, 9.0), (0, 13.0)):
        s = np.clip((time - start) / 3.0, 0.0, 1.0)
        rate[:, axis] += (1.0 - np.cos(2.0 * np.pi * s)) * 0.5 * np.pi / 3.0
    down, force = np.array([0.0, 0.0, G]), np.empty((len(time), 3))
    for k, w in enumerate(rate):  # dg/dt = -w x g
        force[k] = down
        down = down - np.cross(w, down) / RATE_HZ
        down *= G / np.linalg.norm(down)
    gyro = rate + np.array([0.01, -0.02, 0.015]) + rng.normal(0.0, 0.001, rate.shape)
    accel = force + rng.normal(0.0, 0.02, force.shape)
    return Motion(time, gyro, accel, 25.0 + 0.01 * time + rng.normal(0.0, 0.02, len(time)))


@dataclass(frozen=True)
class Shape:
    """A format of a log, and the information that a reader can extract."""

    name: str
    source: str  # Public example or document that it follows
    text: str
    asks: str = ""  # information missing in the text: "rate", "units", "scale"


Line = Callable[[int, float, np.ndarray, np.ndarray, float], str]
SHAPES: dict[str, tuple[str, str, Callable[[Motion], str]]] = {}


def shape(source: str, asks: str = "") -> Callable[[Callable[[Motion], str]], Callable[[Motion], str]]:
    """Enter a writer of text into the table."""

    def enter(writer: Callable[[Motion], str]) -> Callable[[Motion], str]:
        SHAPES[writer.__name__] = (source, asks, writer)
        return writer

    return enter


def shapes() -> list[Shape]:
    """Return every shape with its text."""
    return [Shape(name, source, writer(motion()), asks) for name, (source, asks, writer) in SHAPES.items()]


def lines(made: Motion, line: Line, end: str = "\r\n") -> str:
    """Return one line for each sample."""
    rows = zip(made.time, made.gyro, made.accel, made.temp, strict=True)
    return "".join(line(k, float(t), w, f, float(c)) + end for k, (t, w, f, c) in enumerate(rows))


def codes(values: np.ndarray, per_unit: float) -> list[int]:
    """Return converter codes."""
    return [int(code) for code in np.round(values * per_unit)]


LSB_G, LSB_DPS = 16384.0 / G, 131.0 / DEGREE  # MPU-6050 at +-2 g and 250 deg/s


def six(values: Any, digits: int = 3, between: str = ",") -> str:
    return between.join(f"{value:.{digits}f}" for value in values)


def of_day(t: float, digits: int = 3) -> str:
    """Return a time of day, as a serial monitor stamps lines."""
    s = 12 * 3600 + 34 * 60 + 50.0 + t
    return f"{int(s // 3600):02d}:{int(s % 3600 // 60):02d}:{s % 60:0{3 + digits}.{digits}f}"


# ---- columns without names


@shape("print of six floats between tabs, as most sketches do", "rate")
def tabs_without_names(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: "\t".join(f"{x:.3f}" for x in (*f, *(w / DEGREE))))


@shape("millis() before six floats", "")
def commas_with_millis(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: f"{5231 + round(1000 * t)},{six(f / G, 4)},{six(w / DEGREE, 2)}")


@shape("micros() before six codes; blanks between", "scale")
def blanks_with_micros_codes(m: Motion) -> str:
    def line(k, t, w, f, c):
        return " ".join(map(str, [7_000_123 + round(1e6 * t), *codes(f, LSB_G), *codes(w, LSB_DPS)]))

    return lines(m, line)


@shape("semicolons and decimal commas, as a spreadsheet of a European locale saves", "rate")
def semicolons_with_commas(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: ";".join(f"{x:.3f}".replace(".", ",") for x in (*f, *w)))


@shape("numbers between quotes", "rate")
def quoted_numbers(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: ",".join(f'"{x:.3f}"' for x in (*f, *w)))


# ---- the monitor's own stamps


@shape("Arduino IDE, serial monitor with 'show timestamp': 12:34:56.789 -> text")
def monitor_stamps(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: f"{of_day(t)} -> {six(f)},{six(w)}")


@shape("Arduino IDE 2 stamps, names before numbers")
def monitor_stamps_plotter(m: Motion) -> str:
    def line(k, t, w, f, c):
        return f"{of_day(t)} -> ax:{f[0]:.2f},ay:{f[1]:.2f},az:{f[2]:.2f},gx:{w[0]:.3f},gy:{w[1]:.3f},gz:{w[2]:.3f}"

    return lines(m, line)


@shape("PuTTY and CoolTerm logs: [2026-11-27 12:34:56.789] text")
def bracket_stamps(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: f"[2026-11-27 {of_day(t)}] {six(f)} {six(w)}")


@shape("grabserial, ts: seconds in brackets")
def bracket_seconds(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: f"[{t:12.6f}] {six(f)},{six(w)}")


# ---- names in each line


@shape("Arduino serial plotter: name:value,name:value", "rate")
def plotter(m: Motion) -> str:
    def line(k, t, w, f, c):
        return f"ax:{f[0]:.2f},ay:{f[1]:.2f},az:{f[2]:.2f},gx:{w[0]:.3f},gy:{w[1]:.3f},gz:{w[2]:.3f}"

    return lines(m, line)


@shape("Arduino serial plotter with tabs and blanks", "rate")
def plotter_tabs(m: Motion) -> str:
    def line(k, t, w, f, c):
        names = ("accX", "accY", "accZ", "gyroX", "gyroY", "gyroZ")
        return "\t".join(f"{name}: {x:.3f}" for name, x in zip(names, (*f, *w), strict=True))

    return lines(m, line)


@shape("name=value pairs", "")
def equals(m: Motion) -> str:
    def line(k, t, w, f, c):
        names = ("t_ms", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z")
        return " ".join(f"{n}={x:.3f}" for n, x in zip(names, (1000 * t, *f, *w), strict=True))

    return lines(m, line)


@shape("i2cdevlib, MPU6050_raw: a/g: and six codes between tabs", "rate scale")
def i2cdevlib(m: Motion) -> str:
    head = "Initializing I2C devices...\r\nTesting device connections...\r\nMPU6050 connection successful\r\n"
    head += "Updating internal sensor offsets...\r\n-76\t-2359\t1688\t0\t0\t0\r\n"
    return head + lines(m, lambda k, t, w, f, c: "a/g:\t" + "\t".join(map(str, [*codes(f, LSB_G), *codes(w, LSB_DPS)])))


@shape("a/g: with blanks, as older examples", "rate scale")
def i2cdevlib_blanks(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: "a/g: " + " ".join(map(str, [*codes(f, LSB_G), *codes(w, LSB_DPS)])))


@shape("AcX = ... | of the first tutorial on the MPU-6050: names, codes and Tmp", "rate scale")
def acx(m: Motion) -> str:
    def line(k, t, w, f, c):
        a, g = codes(f, LSB_G), codes(w, LSB_DPS)
        return (
            f"AcX = {a[0]} | AcY = {a[1]} | AcZ = {a[2]} | Tmp = {c:.2f} | GyX = {g[0]} | GyY = {g[1]} | GyZ = {g[2]}"
        )

    return lines(m, line)


@shape(
    "SparkFun ICM-20948, printScaledAGMT: Scaled. Acc (mg) [ ... ], Gyr (DPS) [ ... ], Mag (uT) [ ... ], Tmp (C) [ ... ]",
    "rate",
)
def sparkfun_icm(m: Motion) -> str:
    def line(k, t, w, f, c):
        a = ", ".join(f"{'-' if x < 0 else ' '}{abs(x):08.2f}" for x in 1000 * f / G)
        g = ", ".join(f"{'-' if x < 0 else ' '}{abs(x):08.2f}" for x in w / DEGREE)
        return f"Scaled. Acc (mg) [ {a} ], Gyr (DPS) [ {g} ], Mag (uT) [  00020.10, -00005.40,  00040.20 ], Tmp (C) [  {c:08.2f} ]"

    return lines(m, line)


# ---- words and units, over several lines


@shape("Adafruit MPU6050, basic_readings: three lines and an empty one", "rate")
def adafruit_mpu6050(m: Motion) -> str:
    head = "Adafruit MPU6050 test!\r\nMPU6050 Found!\r\nAccelerometer range set to: +-8G\r\nGyro range set to: +- 500 deg/s\r\n"
    head += "Filter bandwidth set to: 5 Hz\r\n\r\n"

    def line(k, t, w, f, c):
        return (
            f"Acceleration X: {f[0]:.2f}, Y: {f[1]:.2f}, Z: {f[2]:.2f} m/s^2\r\n"
            f"Rotation X: {w[0]:.2f}, Y: {w[1]:.2f}, Z: {w[2]:.2f} rad/s\r\nTemperature: {c:.2f} degC\r\n"
        )

    return head + lines(m, line)


@shape("Adafruit LSM6DS: tabs, units behind, temperature first", "rate")
def adafruit_lsm6ds(m: Motion) -> str:
    head = "Adafruit LSM6DSOX test!\r\nLSM6DSOX Found!\r\nAccelerometer range set to: +-4G\r\n"

    def line(k, t, w, f, c):
        return (
            f"\t\tTemperature {c:.2f} deg C\r\n"
            f"\t\tAccel X: {f[0]:.2f} \tY: {f[1]:.2f} \tZ: {f[2]:.2f} m/s^2 \r\n"
            f"\t\tGyro X: {w[0]:.2f} \tY: {w[1]:.2f} \tZ: {w[2]:.2f} radians/s \r\n"
        )

    return head + lines(m, line)


@shape("Adafruit, CircuitPython examples: Acceleration: X:%.2f, Y: %.2f, Z: %.2f m/s^2", "rate")
def circuitpython(m: Motion) -> str:
    def line(k, t, w, f, c):
        return (
            f"Acceleration: X:{f[0]:.2f}, Y: {f[1]:.2f}, Z: {f[2]:.2f} m/s^2\n"
            f"Gyro X:{w[0]:.2f}, Y: {w[1]:.2f}, Z: {w[2]:.2f} rad/s\n"
        )

    return lines(m, line, "\n")


@shape("STMicroelectronics X-NUCLEO examples: LSM6DSO Accelerometer [mg] and gyroscope [mdps] over two lines", "rate")
def st_mems(m: Motion) -> str:
    def line(k, t, w, f, c):
        a, g = (1000 * f / G), (1000 * w / DEGREE)
        return (
            f"Acceleration [mg]:{a[0]:4.2f}\t{a[1]:4.2f}\t{a[2]:4.2f}\r\n"
            f"Angular rate [mdps]:{g[0]:4.2f}\t{g[1]:4.2f}\t{g[2]:4.2f}\r\nTemperature [degC]:{c:6.2f}"
        )

    return lines(m, line)


@shape("Seeed XIAO nRF52840 Sense, HighLevelExample: blocks of one value a line", "rate")
def seeed_blocks(m: Motion) -> str:
    def line(k, t, w, f, c):
        a = "\r\n".join(f" {axis} = {x:.4f}" for axis, x in zip("XYZ", f / G, strict=True))
        g = "\r\n".join(f" {axis} = {x:.4f}" for axis, x in zip("XYZ", w / DEGREE, strict=True))
        return f"\r\nAccelerometer:\r\n{a}\r\n\r\nGyroscope:\r\n{g}\r\n\r\nThermometer:\r\n Degrees C = {c:.4f}"

    return lines(m, line)


# ---- systems


@shape("ESP-IDF: I (1234) tag: text; ms since start")
def esp_idf(m: Motion) -> str:
    boot = (
        "ets Jul 29 2019 12:21:46\n\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\nload:0x3fff0030,len:1344\n"
        "I (29) boot: ESP-IDF v5.1 2nd stage bootloader\nI (334) main_task: Calling app_main()\n"
    )

    def line(k, t, w, f, c):
        a, g = f / G, w / DEGREE
        return (
            f"I ({400 + round(1000 * t)}) mpu6050: acce_x:{a[0]:.3f}, acce_y:{a[1]:.3f}, acce_z:{a[2]:.3f}, "
            f"gyro_x:{g[0]:.2f}, gyro_y:{g[1]:.2f}, gyro_z:{g[2]:.2f}"
        )

    return boot + lines(m, line, "\n")


@shape("ESP-IDF with colours of the terminal")
def esp_idf_colours(m: Motion) -> str:
    def line(k, t, w, f, c):
        return f"\x1b[0;32mI ({400 + round(1000 * t)}) imu: {six(f)} {six(w)}\x1b[0m"

    return lines(m, line, "\n")


@shape("Zephyr log: [00:00:01.234,567] <inf> sensor: text")
def zephyr_log(m: Motion) -> str:
    boot = "*** Booting Zephyr OS build v3.6.0 ***\r\n"

    def line(k, t, w, f, c):
        us = round(1e6 * t)
        return f"[00:00:{us // 1000000:02d}.{us // 1000 % 1000:03d},{us % 1000:03d}] <inf> imu: {six(f)}, {six(w)}"

    return boot + lines(m, line)


@shape("Zephyr sample mpu6050: [0:00:01.234]: 25.1 Cel and accel/gyro lines")
def zephyr_mpu6050(m: Motion) -> str:
    def line(k, t, w, f, c):
        return f"[0:00:{t:06.3f}]:{c:g} Cel\r\n  accel {f[0]:f} {f[1]:f} {f[2]:f} m/s/s\r\n  gyro  {w[0]:f} {w[1]:f} {w[2]:f} rad/s"

    return lines(m, line)


@shape("JSON lines with epoch seconds")
def json_lines(m: Motion) -> str:
    def line(k, t, w, f, c):
        row = {"ts": round(1.79e9 + t, 3)} | {f"accel_{a}": round(float(x), 4) for a, x in zip("xyz", f, strict=True)}
        return json.dumps(row | {f"gyro_{a}": round(float(x), 5) for a, x in zip("xyz", w, strict=True)})

    return lines(m, line, "\n")


@shape("JSON lines with arrays and ms")
def json_arrays(m: Motion) -> str:
    def line(k, t, w, f, c):
        return json.dumps(
            {
                "millis": round(1000 * t),
                "acc": [round(float(x), 4) for x in f / G],
                "gyr": [round(float(x), 3) for x in w / DEGREE],
            }
        )

    return lines(m, line, "\n")


@shape("JSON lines with objects")
def json_objects(m: Motion) -> str:
    def line(k, t, w, f, c):
        a, g = ({axis: round(float(x), 5) for axis, x in zip("xyz", v, strict=True)} for v in (f, w))
        return json.dumps({"t": round(t, 4), "accel": a, "gyro": g, "temp": round(c, 2)}, separators=(",", ":"))

    return lines(m, line, "\n")


@shape("a word before the numbers: IMU,1,2,3", "rate")
def tagged(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: f"IMU,{six(f)},{six(w)}")


@shape("a word before the numbers, rates first, temperature last", "rate")
def tagged_rates_first(m: Motion) -> str:
    return lines(m, lambda k, t, w, f, c: f"data: {six(w / DEGREE, 2)}, {six(f / G)}, {c:.2f}")


@shape("a stamp, a counter and codes", "scale")
def stamped_counter(m: Motion) -> str:
    def line(k, t, w, f, c):
        return f"{of_day(t)} -> #{k % 256} {' '.join(map(str, [*codes(f, LSB_G), *codes(w, LSB_DPS)]))}"

    return lines(m, line)


# ---- names in a header


@shape("header in English", "")
def header(m: Motion) -> str:
    names = [
        "time (s)",
        *(f"acceleration {a} (m/s^2)" for a in "xyz"),
        *(f"gyro {a} (deg/s)" for a in "xyz"),
        "temperature (°C)",
    ]
    return (
        ";".join(names)
        + "\n"
        + lines(m, lambda k, t, w, f, c: ";".join(f"{x:.4f}" for x in (t, *f, *(w / DEGREE), c)), "\n")
    )


# ---- damage that every log has


@shape("boot noise before, one broken line amid, cut at the end", "")
def noisy(m: Motion) -> str:
    body = lines(m, lambda k, t, w, f, c: f"{round(1000 * t)},{six(f)},{six(w)}").splitlines(keepends=True)
    body[700] = body[700][:14] + body[701]
    return "\x00\x11garbage\r\nboot\r\nIMU ready\r\n" + "".join(body)[:-9]


@shape("a reset amid: the header is printed again", "")
def header_again(m: Motion) -> str:
    head = "t_ms,ax,ay,az,gx,gy,gz\r\n"
    body = lines(m, lambda k, t, w, f, c: f"{round(1000 * t)},{six(f)},{six(w)}").splitlines(keepends=True)
    return head + "".join(body[:1000]) + head + "".join(body[1000:])
