// Prints the raw readings of an MPU-6050 in the shape that undrift reads without a map, 100 times a second at 115200 baud:
//   count:17,time(s):0.170012,gyro(count):-12,34,5,accel(count):120,-88,16320,temp(C):25.31
// Wiring: VCC, GND, SDA, SCL. Another part: change the registers, the scale of the temperature and, if need be, the byte order.
// SPDX-License-Identifier: MIT
#include <Arduino.h>
#include <Wire.h>

const uint8_t IMU = 0x68;
const uint32_t PERIOD_US = 10000;  // a line is up to 115 bytes: 100 of them a second fill 115200 baud

uint32_t count, seconds, micros_of_second, before, due;

void set(uint8_t reg, uint8_t value) {
  Wire.beginTransmission(IMU);
  Wire.write(reg);
  Wire.write(value);
  Wire.endTransmission();
}

void print_three(const char *name, const int16_t *values) {
  Serial.print(name);
  for (int i = 0; i < 3; i++) {
    if (i) Serial.print(',');
    Serial.print(values[i]);
  }
}

void setup() {
  Serial.begin(115200);
  Wire.begin();
  Wire.setClock(400000);
  set(0x6B, 0x01);  // awake, clock of the gyroscope
  set(0x1A, 0x03);  // low-pass filter of 42 Hz
  set(0x1B, 0x00);  // +-250 deg/s: 131 counts per deg/s
  set(0x1C, 0x00);  // +-2 g: 16384 counts per g
  before = due = micros();
}

void loop() {
  uint32_t now = micros();
  if ((int32_t)(now - due) < 0) return;
  due += PERIOD_US;
  micros_of_second += now - before;  // micros() begins anew after 71 min, seconds do not
  before = now;
  while (micros_of_second >= 1000000) {
    micros_of_second -= 1000000;
    seconds++;
  }
  count++;
  Wire.beginTransmission(IMU);
  Wire.write(0x3B);
  Wire.endTransmission(false);
  if (Wire.requestFrom(IMU, (uint8_t)14) != 14) return;  // a number is missing: undrift marks a gap
  int16_t raw[7];  // accelerometers, temperature, gyroscopes: high byte first
  for (int i = 0; i < 7; i++) {
    uint8_t high = Wire.read();
    raw[i] = (int16_t)((high << 8) | Wire.read());
  }
  Serial.print("count:");
  Serial.print(count);
  Serial.print(",time(s):");
  Serial.print(seconds);
  Serial.print('.');
  for (uint32_t digit = 100000; digit > 0; digit /= 10) Serial.print(micros_of_second / digit % 10);
  print_three(",gyro(count):", raw + 4);
  print_three(",accel(count):", raw);
  Serial.print(",temp(C):");
  Serial.println(raw[3] / 340.0 + 36.53, 2);
}
