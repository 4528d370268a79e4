/* A base on a pseudo-terminal, with simulated motors and encoders: for tests, and to try the drive without a robot.

     posix_base             time passes by the clock
     posix_base --stepped   time passes only as lines on standard input say: MICROSECONDS, STOPPED (0 or 1),
                            PLACE (1: somebody presses the button)

   It prints the path of the pseudo-terminal; with --stepped it then answers each line with the true state: time, us;
   speeds, um/s, and ways, um, of both wheels; numbers of commands accepted and lines rejected. It ends with standard
   input, or by a signal. */

#define _XOPEN_SOURCE 700

#include "robot/base.h"

#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { CONTROL = 1000, ANSWERS = 7, BATTERY = 7400 }; /* us; control periods; mV */

static const base_config CONFIG = {
    .nm_per_count = 209440, /* 600 counts per turn of a wheel of 20 mm radius */
    .max_speed = 500000,
    .max_acceleration = 4e6f,
    .full_speed = 600000.0f,
    .stiffness = 15.0f,
    .max_distance = 20000.0f,
    .bandwidth = 60.0f,
    .watchdog = 200000,
    .placed = false,
};
static const double FULL_SPEED[BASE_WHEELS] = {620000.0, 560000.0}; /* no two motors are equal; um/s */
static const double LAG = 0.03;                                     /* s */

typedef struct {
    base_robot base;
    uint32_t time; /* us */
    double speed[BASE_WHEELS], way[BASE_WHEELS];
    int terminal;
    unsigned since_answer; /* control periods */
} simulation;

static void hear(simulation *robot)
{
    char bytes[256];
    for (ssize_t count; (count = read(robot->terminal, bytes, sizeof bytes)) > 0;)
        for (ssize_t i = 0; i < count; i++)
            base_receive(&robot->base, bytes[i], robot->time);
}

static void control(simulation *robot, bool stopped)
{
    int32_t counts[BASE_WHEELS];
    int16_t powers[BASE_WHEELS];
    for (int i = 0; i < BASE_WHEELS; i++)
        counts[i] = (int32_t)floor(robot->way[i] * 1000.0 / CONFIG.nm_per_count);
    base_update(&robot->base, robot->time, counts, stopped, powers);
    const double dt = CONTROL * 1e-6;
    for (int i = 0; i < BASE_WHEELS; i++) {
        double drive = FULL_SPEED[i] * powers[i] / BASE_FULL_POWER;
        robot->speed[i] += (1.0 - exp(-dt / LAG)) * (drive - robot->speed[i]);
        robot->way[i] += robot->speed[i] * dt;
    }
    robot->time += CONTROL;
    if (++robot->since_answer >= ANSWERS) {
        robot->since_answer = 0;
        char line[BASE_LINE];
        size_t length = base_answer(&robot->base, robot->time, BATTERY, line);
        if (write(robot->terminal, line, length) < 0)
            return; /* nobody reads: this line is lost, as on a real one */
    }
}

static void run_stepped(simulation *robot)
{
    unsigned long time;
    unsigned stopped, place;
    while (scanf("%lu %u %u", &time, &stopped, &place) == 3) {
        hear(robot);
        if (place)
            base_place(&robot->base);
        for (; time >= CONTROL; time -= CONTROL)
            control(robot, stopped != 0);
        printf("%lu %.3f %.3f %.3f %.3f %lu %lu\n", (unsigned long)robot->time, robot->speed[0], robot->speed[1],
               robot->way[0], robot->way[1], (unsigned long)robot->base.accepted,
               (unsigned long)robot->base.rejected);
        fflush(stdout);
    }
}

static void run_by_the_clock(simulation *robot)
{
    struct timespec start, now;
    clock_gettime(CLOCK_MONOTONIC, &start);
    base_place(&robot->base);
    for (struct pollfd input = {.fd = STDIN_FILENO, .events = POLLIN}; poll(&input, 1, 1) == 0;) {
        clock_gettime(CLOCK_MONOTONIC, &now);
        uint32_t passed = (uint32_t)((now.tv_sec - start.tv_sec) * 1000000 + (now.tv_nsec - start.tv_nsec) / 1000);
        hear(robot);
        while (passed - robot->time >= CONTROL && passed - robot->time < UINT32_MAX / 2)
            control(robot, false);
    }
}

int main(int count, char **words)
{
    static simulation robot;
    base_init(&robot.base, &CONFIG);
    robot.terminal = posix_openpt(O_RDWR | O_NOCTTY);
    if (robot.terminal < 0 || grantpt(robot.terminal) || unlockpt(robot.terminal)) {
        perror("posix_base: no pseudo-terminal");
        return 1;
    }
    const char *path = ptsname(robot.terminal);
    int kept = path ? open(path, O_RDWR | O_NOCTTY) : -1; /* otherwise it would hang up before the drive opens it */
    struct termios settings;
    if (kept < 0 || tcgetattr(kept, &settings)) {
        perror("posix_base: the pseudo-terminal cannot be opened");
        return 1;
    }
    settings.c_iflag = settings.c_oflag = settings.c_lflag = 0; /* raw: no echo, no translation */
    tcsetattr(kept, TCSANOW, &settings);
    fcntl(robot.terminal, F_SETFL, O_NONBLOCK);
    printf("%s\n", path);
    fflush(stdout);
    if (count > 1 && strcmp(words[1], "--stepped") == 0)
        run_stepped(&robot);
    else
        run_by_the_clock(&robot);
    return 0;
}
