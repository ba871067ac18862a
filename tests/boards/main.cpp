// Runs the sketch for ten seconds.
#include "board.ino"

int main() {
  setup();
  for (int step = 0; step < 10000; step++) {
    now_us += 1000;
    if (step % 10 == 0) on_interrupt();
    loop();
  }
}
