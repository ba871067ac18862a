// An ESP32 with an MPU-6050 as a sensor of posed: lines of the open format over UDP, found by broadcast. Arduino IDE or PlatformIO.
//
// Wiring: 3V3, GND, SDA to 21, SCL to 22, INT to 4. Write your network below, then name the board in the stage file:
//   [[device]]  name = "boards"  driver = "open-imu"  port = "udp://0.0.0.0:9302"  devices = ["esp-..."]   (it prints its identifier)
#include <Arduino.h>
#include <WiFi.h>
#include <WiFiUdp.h>
#include <Wire.h>

const char *NETWORK = "my network", *PASSWORD = "my password";
const uint16_t PORT = 9302;  // lines over UDP
const uint8_t MPU = 0x68, READY_PIN = 4;
const float GYRO_RAD_S = 2000.0f / 32768 * 3.14159265f / 180, ACC_M_S2 = 8.0f / 32768 * 9.80665f;

WiFiUDP udp;
IPAddress server(255, 255, 255, 255);
bool found = false;
char id[24];
uint32_t number = 0, next_word_ms = 0;
volatile uint32_t measured_us = 0;
volatile bool ready = false;

// The time of a sample is taken where the sensor says that it is there, not where it is read.
void IRAM_ATTR onReady() {
  measured_us = micros();
  ready = true;
}

void setRegister(uint8_t address, uint8_t value) {
  Wire.beginTransmission(MPU);
  Wire.write(address), Wire.write(value);
  Wire.endTransmission();
}

void sendBytes(const char *bytes) {
  udp.beginPacket(server, PORT);
  udp.write((const uint8_t *)bytes, strlen(bytes));
  udp.endPacket();
}

// A line: $ fields * checksum.
void send(const char *fields) {
  uint8_t sum = 0;
  for (const char *c = fields; *c; c++) sum ^= *c;
  char line[256];
  snprintf(line, sizeof line, "$%s*%02X\n", fields, sum);
  sendBytes(line);
}

void setup() {
  Serial.begin(115200);
  uint64_t mac = ESP.getEfuseMac();
  snprintf(id, sizeof id, "esp-%08x", (unsigned)(mac >> 16));
  Serial.println(id);
  WiFi.begin(NETWORK, PASSWORD);
  WiFi.setSleep(false);  // sleep makes samples wait for up to 100 ms
  while (WiFi.status() != WL_CONNECTED) delay(100);
  udp.begin(PORT);
  Wire.begin(), Wire.setClock(400000);
  setRegister(0x6B, 1);     // awake, clock of the gyro
  setRegister(0x1A, 3);     // 44 Hz low-pass
  setRegister(0x19, 9);     // 1 kHz / 10
  setRegister(0x1B, 0x18);  // 2000 degrees/s
  setRegister(0x1C, 0x10);  // 8 g
  setRegister(0x38, 1);     // INT when a sample is there
  pinMode(READY_PIN, INPUT);
  attachInterrupt(digitalPinToInterrupt(READY_PIN), onReady, RISING);
}

void loop() {
  // Whoever answers the question for a server is it.
  char answer[64] = {0};
  if (udp.parsePacket() > 0 && udp.read((uint8_t *)answer, sizeof answer - 1) > 0 && strncmp(answer, "IMU!1", 5) == 0) {
    server = udp.remoteIP();
    found = true;
  }
  char fields[200];
  if ((int32_t)(millis() - next_word_ms) >= 0) {
    next_word_ms = millis() + (found ? 5000 : 1000);
    snprintf(fields, sizeof fields, "H,%s,1,ESP32,mpu6050 1,100,us,32", id);
    send(fields);
    if (!found) sendBytes("IMU?1");
  }
  if (!ready) return;
  ready = false;
  const uint32_t t_us = measured_us;
  Wire.beginTransmission(MPU);
  Wire.write(0x3B);
  Wire.endTransmission(false);
  if (Wire.requestFrom(MPU, (uint8_t)14) != 14) return;
  int16_t raw[7];  // acceleration, temperature, angular velocity
  for (int16_t &word : raw) {
    uint16_t high = Wire.read();
    word = (int16_t)(high << 8 | Wire.read());
  }
  snprintf(fields, sizeof fields, "I,%s,0,%lu,%lu,%.5f,%.5f,%.5f,%.4f,%.4f,%.4f", id, (unsigned long)number++, (unsigned long)t_us,
           raw[4] * GYRO_RAD_S, raw[5] * GYRO_RAD_S, raw[6] * GYRO_RAD_S, raw[0] * ACC_M_S2, raw[1] * ACC_M_S2, raw[2] * ACC_M_S2);
  send(fields);
}
