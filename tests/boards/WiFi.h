#pragma once
#include "Arduino.h"
enum { WL_CONNECTED = 3 };
struct IPAddress {
  uint8_t bytes[4];
  IPAddress(uint8_t a, uint8_t b, uint8_t c, uint8_t d) : bytes{a, b, c, d} {}
};
struct Wireless {
  void begin(const char *, const char *) {}
  void setSleep(bool) {}
  int status() { return WL_CONNECTED; }
};
inline Wireless WiFi;
