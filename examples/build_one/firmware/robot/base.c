#include "base.h"

#include <stdio.h>
#include <string.h>

static uint16_t checksum(const char *text, size_t length)
{
    uint16_t sum = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        sum ^= (uint16_t)((uint8_t)text[i] << 8);
        for (int bit = 0; bit < 8; bit++)
            sum = (uint16_t)(sum & 0x8000 ? (sum << 1) ^ 0x1021 : sum << 1);
    }
    return sum;
}

/* Read an integer within +-limit that ends with `end`, and step behind it. */
static bool number(const char **text, char end, int64_t limit, int64_t *value)
{
    const char *at = *text;
    bool negative = *at == '-';
    if (negative)
        at++;
    if (*at < '0' || *at > '9')
        return false;
    int64_t sum = 0;
    for (; *at >= '0' && *at <= '9'; at++) {
        sum = 10 * sum + (*at - '0');
        if (sum > limit)
            return false;
    }
    if (*at != end)
        return false;
    *text = at + 1;
    *value = negative ? -sum : sum;
    return true;
}

/* Obey a complete line; return whether it was valid. */
static bool obey(base_robot *base, uint32_t now)
{
    char *star = strrchr(base->line, '*');
    if (star == NULL)
        return false;
    char sum[5];
    snprintf(sum, sizeof sum, "%04X", checksum(base->line, (size_t)(star - base->line)));
    if (strcmp(star + 1, sum) != 0)
        return false;
    int64_t count, velocity;
    const char *text = base->line + 2;
    if (strncmp(base->line, "V,", 2) != 0 || !number(&text, ',', UINT32_MAX, &count) || count < 0)
        return false;
    if (!number(&text, '*', base->config.max_speed, &velocity) || text != star + 1)
        return false;
    base->number = (uint32_t)count;
    base->command = (int32_t)velocity;
    base->heard = now;
    base->silent = false;
    return true;
}

void base_init(base_robot *base, const base_config *config)
{
    memset(base, 0, sizeof *base);
    base->config = *config;
    base->silent = true;
    base->placed = config->placed;
}

void base_receive(base_robot *base, char byte, uint32_t now)
{
    if (byte != '\n') {
        if (base->length < BASE_LINE)
            base->line[base->length++] = byte;
        return;
    }
    bool complete = base->length < BASE_LINE && memchr(base->line, '\0', base->length) == NULL;
    if (complete)
        base->line[base->length] = '\0';
    base->length = 0;
    if (complete && obey(base, now))
        base->accepted++;
    else
        base->rejected++;
}

static float limited(float value, float limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

static float um(const base_robot *base, int32_t counts)
{
    return (float)counts * (float)base->config.nm_per_count / 1000.0f;
}

/* Follow the encoder with a filter of second order, both poles at the bandwidth. */
static void measure(const base_robot *base, base_wheel *wheel, int32_t counts, float dt)
{
    float moved = um(base, wheel->counts - wheel->origin);
    wheel->origin = wheel->counts;
    wheel->position -= moved;
    wheel->target -= moved;
    wheel->counts = counts;
    float w = base->config.bandwidth;
    float error = um(base, counts - wheel->origin) - wheel->position;
    wheel->position += dt * (wheel->velocity + 2.0f * w * error);
    wheel->velocity += dt * w * w * error;
}

void base_update(base_robot *base, uint32_t now, const int32_t counts[BASE_WHEELS], bool stopped,
                 int16_t powers[BASE_WHEELS])
{
    const base_config *config = &base->config;
    if (!base->started) {
        base->started = true;
        base->updated = now;
        for (int i = 0; i < BASE_WHEELS; i++) {
            base->wheels[i].counts = base->wheels[i].origin = counts[i];
            base->zero[i] = config->placed ? 0 : counts[i];
        }
    }
    float dt = (float)(now - base->updated) * 1e-6f;
    base->updated = now;
    /* Once silent it remains so until a command: the difference of times returns to 0 every 71 minutes. */
    if (now - base->heard > config->watchdog)
        base->silent = true;
    if (stopped)
        base->placed = false; /* it may be moved by hand before it is released */
    bool driving = base_get_state(base) == BASE_DRIVING;
    float change = limited((driving ? (float)base->command : 0.0f) - base->speed, config->max_acceleration * dt);
    base->speed = base->placed ? base->speed + change : 0.0f;
    for (int i = 0; i < BASE_WHEELS; i++) {
        base_wheel *wheel = &base->wheels[i];
        measure(base, wheel, counts[i], dt);
        float position = um(base, counts[i] - wheel->origin);
        wheel->target = position + limited(wheel->target + base->speed * dt - position, config->max_distance);
        if (!base->placed)
            wheel->target = position; /* without power, so that it can be put on its mark */
        float speed = base->speed + config->stiffness * (wheel->target - position);
        powers[i] = (int16_t)limited(BASE_FULL_POWER * speed / config->full_speed, BASE_FULL_POWER);
    }
}

void base_place(base_robot *base)
{
    if (base_get_state(base) == BASE_DRIVING && base->command != 0)
        return;
    for (int i = 0; i < BASE_WHEELS; i++)
        base->zero[i] = base->wheels[i].counts;
    base->placed = true;
}

base_state base_get_state(const base_robot *base)
{
    if (!base->placed)
        return BASE_UNPLACED;
    return base->silent ? BASE_SILENT : BASE_DRIVING;
}

size_t base_answer(const base_robot *base, uint32_t now, unsigned battery, char line[BASE_LINE])
{
    int64_t counts = 0;
    float velocity = 0.0f;
    for (int i = 0; i < BASE_WHEELS; i++) {
        counts += base->wheels[i].counts - base->zero[i];
        velocity += base->wheels[i].velocity / BASE_WHEELS;
    }
    long position = (long)(counts * base->config.nm_per_count / (1000 * BASE_WHEELS));
    int length = snprintf(line, BASE_LINE, "O,%lu,%ld,%ld,%lu,%lu,%d,%u,%lu", (unsigned long)now, position,
                          (long)velocity, (unsigned long)base->number, (unsigned long)(now - base->heard),
                          (int)base_get_state(base), battery, (unsigned long)base->rejected);
    unsigned sum = checksum(line, (size_t)length);
    return (size_t)(length + snprintf(line + length, BASE_LINE - (size_t)length, "*%04X\n", sum));
}
