#pragma once
#include "WiFi.h"
#include <string>
// A network whose server answers the first question for it.
struct WiFiUDP {
  std::string sending, pending;
  void begin(uint16_t) {}
  void beginPacket(IPAddress, uint16_t) { sending.clear(); }
  size_t write(const uint8_t *data, size_t len) { return sending.append((const char *)data, len), len; }
  int endPacket() {
    if (sending == "IMU?1") pending = "IMU!1 posed 0 9302 9302";
    for (unsigned char byte : sending) printf("%02x", byte);
    return printf("\n");
  }
  int parsePacket() { return (int)pending.size(); }
  int read(uint8_t *to, size_t len) {
    size_t count = pending.size() < len ? pending.size() : len;
    memcpy(to, pending.data(), count);
    pending.clear();
    return (int)count;
  }
  IPAddress remoteIP() { return IPAddress(192, 0, 2, 1); }
};
