// As much of the Arduino API of an ESP32 as examples/open-imu/board.ino uses, for a test on a computer: time passes with each delay and
// each turn of loop(), the sensor lies still with z up, and each datagram is a line of hexadecimal digits on the standard output.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstring>

#define IRAM_ATTR
enum { INPUT, RISING };
inline uint32_t now_us = 4294000000u;
inline void (*on_interrupt)() = nullptr;
inline uint32_t micros() { return now_us; }
inline uint32_t millis() { return now_us / 1000; }
inline void delay(uint32_t ms) { now_us += 1000 * ms; }
inline void pinMode(int, int) {}
inline int digitalPinToInterrupt(int pin) { return pin; }
inline void attachInterrupt(int, void (*handler)(), int) { on_interrupt = handler; }
struct SerialPort {
  void begin(int) {}
  void println(const char *) {}
};
inline SerialPort Serial;
struct Chip {
  uint64_t getEfuseMac() { return 0x7f3a12345678abcdull; }
};
inline Chip ESP;
