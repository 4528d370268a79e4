/* The base of a robot: serial line, watchdog and speed control, independent of the board that it runs on.

   Lines of text, each with a checksum:

     V,NUMBER,VELOCITY*CCCC                                               to the base
     O,TIME,POSITION,VELOCITY,NUMBER,SINCE,STATE,BATTERY,REJECTED*CCCC    from the base

   VELOCITY in um/s and POSITION in um along the robot's x axis; TIME of the base in us; NUMBER of the newest valid
   command, and SINCE when it was received, us; STATE as below; BATTERY in mV; REJECTED lines so far. CCCC is
   CRC-16/CCITT-FALSE of what precedes the asterisk, in capital hexadecimal digits. A line that is torn, garbled, too
   long or out of range changes nothing but REJECTED. */

#ifndef BASE_H
#define BASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { BASE_WHEELS = 2, BASE_LINE = 96, BASE_FULL_POWER = 1000 };

typedef enum {
    BASE_DRIVING = 0,
    BASE_SILENT = 1,   /* no valid command for the time of the watchdog: the wheels hold still until the next one */
    BASE_UNPLACED = 2, /* since its start or its emergency stop nobody has put it on its mark and pressed the button */
} base_state;

typedef struct {
    int32_t nm_per_count; /* way of the rim per count of a wheel's encoder, nm */
    int32_t max_speed;    /* largest accepted command, um/s */
    float max_acceleration; /* um/s^2 */
    float full_speed;       /* speed at full power on a level plane, um/s */
    float stiffness;        /* correcting speed per distance from the commanded path, 1/s */
    float max_distance;     /* largest distance from that path that is corrected, um */
    float bandwidth;        /* of the filter that derives velocity, rad/s */
    uint32_t watchdog;      /* us */
    bool placed;            /* whether the position is valid from the start, as that of an absolute encoder */
} base_config;

typedef struct {
    float target;   /* where the wheel should be, um from `origin` */
    float position; /* filtered, um from `origin` */
    float velocity; /* filtered, um/s */
    int32_t counts;
    int32_t origin; /* counts from which the floats are measured, so that they stay small */
} base_wheel;

typedef struct {
    base_config config;
    base_wheel wheels[BASE_WHEELS];
    int32_t zero[BASE_WHEELS]; /* counts where the robot was placed */
    bool started, placed, silent;
    uint32_t updated, heard; /* us */
    float speed;             /* reference of the speed control, um/s */
    int32_t command;         /* um/s */
    uint32_t number, accepted, rejected;
    char line[BASE_LINE];
    size_t length;
} base_robot;

void base_init(base_robot *base, const base_config *config);

/* Take a byte from the serial line at a time of the base, us. */
void base_receive(base_robot *base, char byte, uint32_t now);

/* Control the wheels, at least every 10 ms: take the counts of their encoders, set powers within +-BASE_FULL_POWER.
   `stopped` is the auxiliary contact of the emergency stop, which itself cuts the power of the motors. */
void base_update(base_robot *base, uint32_t now, const int32_t counts[BASE_WHEELS], bool stopped,
                 int16_t powers[BASE_WHEELS]);

/* Count positions from here on, because the robot is on its mark and the button was pressed. A moving robot ignores it:
   its position would jump. */
void base_place(base_robot *base);

base_state base_get_state(const base_robot *base);

/* Write a line of odometry into `line`, with its end; return its length. */
size_t base_answer(const base_robot *base, uint32_t now, unsigned battery, char line[BASE_LINE]);

#ifdef __cplusplus
}
#endif
#endif
