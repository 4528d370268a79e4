// A robot with two geared motors with encoders, a dual H bridge, a button and an emergency stop, on any board whose
// core provides Arduino's functions. All that decides is in base.c.
//
// As the sensor of the plane's axis: an encoder instead of the left one, no motors, PLANE defined.

#include <Arduino.h>

#include "base.h"

// #define PLANE

// Pins: forward and backward inputs of the bridge, channels A and B of the encoders.
static const uint8_t FORWARD[BASE_WHEELS] = {5, 9}, BACKWARD[BASE_WHEELS] = {6, 10};
static const uint8_t CHANNEL_A[BASE_WHEELS] = {2, 3}, CHANNEL_B[BASE_WHEELS] = {4, 7};
static const uint8_t BUTTON = 8, STOP_CONTACT = 12;  // both connect to ground; the contact opens when pressed
static const uint8_t BATTERY = A0;                   // behind a divider
static const float MILLIVOLT_PER_COUNT = 9.77F;      // 5 V / 1024, divider 1 : 2
static const uint32_t CONTROL = 1000, ANSWER = 7000; // us

#ifdef PLANE
// Millionths of a radian take the place of um: 4096 counts per turn of the encoder, ten turns of it per turn of the axis.
static const base_config CONFIG = {153398, 1, 1.0F, 1.0F, 0.0F, 0.0F, 100.0F, 200000, false};
#else
// Turns of a wheel of 20 mm radius by 600 counts; calibrate the rest in the drive's `scale`.
static const base_config CONFIG = {209440, 500000, 2e6F, 600000.0F, 15.0F, 20000.0F, 60.0F, 200000, false};
#endif

static base_robot base;
static volatile int32_t counts[BASE_WHEELS];
static uint32_t controlled, answered;

// Edges of channel A count: a falling one, or a rising one, with the direction that channel B shows.
template <int WHEEL>
static void edge()
{
    bool forwards = digitalRead(CHANNEL_A[WHEEL]) != digitalRead(CHANNEL_B[WHEEL]);
    counts[WHEEL] = counts[WHEEL] + (forwards ? 1 : -1);
}

void setup()
{
    Serial.begin(230400);
    for (int i = 0; i < BASE_WHEELS; i++) {
        pinMode(FORWARD[i], OUTPUT);
        pinMode(BACKWARD[i], OUTPUT);
        pinMode(CHANNEL_A[i], INPUT_PULLUP);
        pinMode(CHANNEL_B[i], INPUT_PULLUP);
    }
    pinMode(BUTTON, INPUT_PULLUP);
    pinMode(STOP_CONTACT, INPUT_PULLUP);
    attachInterrupt(digitalPinToInterrupt(CHANNEL_A[0]), edge<0>, CHANGE);
    attachInterrupt(digitalPinToInterrupt(CHANNEL_A[1]), edge<1>, CHANGE);
    base_init(&base, &CONFIG);
}

static void drive(int wheel, int16_t power)
{
    int duty = (int)(255L * abs(power) / BASE_FULL_POWER);
    analogWrite(FORWARD[wheel], power > 0 ? duty : 0);
    analogWrite(BACKWARD[wheel], power < 0 ? duty : 0);
}

void loop()
{
    uint32_t now = micros();
    while (Serial.available() > 0)
        base_receive(&base, (char)Serial.read(), now);
    if (now - controlled >= CONTROL) {
        controlled = now;
        int32_t read[BASE_WHEELS];
        noInterrupts();
        for (int i = 0; i < BASE_WHEELS; i++)
            read[i] = counts[i];
        interrupts();
#ifdef PLANE
        read[1] = read[0];
        bool stopped = false;
#else
        bool stopped = digitalRead(STOP_CONTACT) == HIGH;
#endif
        int16_t powers[BASE_WHEELS];
        base_update(&base, now, read, stopped, powers);
#ifndef PLANE
        for (int i = 0; i < BASE_WHEELS; i++)
            drive(i, powers[i]);
#endif
        if (!stopped && digitalRead(BUTTON) == LOW)
            base_place(&base);
    }
    if (now - answered >= ANSWER) {
        answered = now;
        char line[BASE_LINE];
        size_t length = base_answer(&base, now, (unsigned)(analogRead(BATTERY) * MILLIVOLT_PER_COUNT), line);
        Serial.write((const uint8_t *)line, length);
    }
}
