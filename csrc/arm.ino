/* An arm for `fraclink tune`: quadrature encoder, strain gauge on an analog input, H-bridge. For a Teensy, an ESP32, a
 * Pico or another board with native USB or a serial line of 1 Mbaud. Put arm_link.c and arm_link.h next to this file.
 *
 *   fraclink tune --io serial:/dev/ttyACM0@1000000 --payload 0.030
 *
 * Fill in the lines with numbers: pins, counts, the gauge's scale and the supply. */
extern "C" {
#include "arm_link.h"
}

const uint32_t PERIOD_US = 4000;
const int ENCODER_A = 2, ENCODER_B = 3, GAUGE = A0, BRIDGE_PWM = 5, BRIDGE_SIDE = 6, BRIDGE_ON = 7;
const float RAD_PER_COUNT = 6.2831853f / (4 * 1024 * 14); /* per turn: edges, lines, gear ratio */
/* scale of the analog input; determine it by hanging a known mass on the tip */
const float NEWTON_METRES_PER_STEP = 0.0005f;
const float SUPPLY = 12.0f;                               /* supply voltage of the H-bridge [V] */

static volatile int32_t counts;
static arm_link arm;
static uint32_t next_us;

void on_edge_a() { counts += digitalRead(ENCODER_A) == digitalRead(ENCODER_B) ? 1 : -1; }
void on_edge_b() { counts += digitalRead(ENCODER_A) == digitalRead(ENCODER_B) ? -1 : 1; }

void drive(float voltage)
{
    const float part = constrain(voltage / SUPPLY, -1.0f, 1.0f);
    digitalWrite(BRIDGE_SIDE, part < 0 ? HIGH : LOW);
    analogWrite(BRIDGE_PWM, (int)(4095.0f * fabsf(part)));
    digitalWrite(BRIDGE_ON, voltage != 0.0f ? HIGH : LOW);
}

void setup()
{
    pinMode(ENCODER_A, INPUT_PULLUP);
    pinMode(ENCODER_B, INPUT_PULLUP);
    pinMode(BRIDGE_SIDE, OUTPUT);
    pinMode(BRIDGE_ON, OUTPUT);
    analogReadResolution(12);
    analogWriteResolution(12);
    attachInterrupt(digitalPinToInterrupt(ENCODER_A), on_edge_a, CHANGE);
    attachInterrupt(digitalPinToInterrupt(ENCODER_B), on_edge_b, CHANGE);
    drive(0.0f);
    Serial.begin(1000000);
    /* The lowest bits of the gauge are noise and give another number at every start. */
    uint32_t seed = micros();
    for (int i = 0; i < 32; i++)
        seed = 31 * seed + analogRead(GAUGE);
    arm_link_begin(&arm, PERIOD_US, seed);
    next_us = micros();
}

void loop()
{
    while (Serial.available() > 0)
        arm_link_take(&arm, (uint8_t)Serial.read());
    if ((int32_t)(micros() - next_us) < 0)
        return;
    next_us += PERIOD_US;
    noInterrupts();
    const int32_t now = counts;
    interrupts();
    float voltage;
    uint8_t message[ARM_LINK_MESSAGE];
    const int called =
        arm_link_period(&arm, RAD_PER_COUNT * now, NEWTON_METRES_PER_STEP * analogRead(GAUGE), &voltage, message);
    drive(voltage);
    if (called)
        Serial.write(message, sizeof(message));
}
