/* Messages between controller and arm: little-endian on every machine, with a sequence number and a checksum. */
#include "realtime.h"

#ifdef __linux__

#include <string.h>
#include <sys/random.h>

#define MAGIC 0x54524C46U /* "FLRT" */
#define VERSION 2U
#define CHECKED (MESSAGE_BYTES - 4) /* bytes before the checksum */
/* A flood of datagrams must not delay the period; a healthy peer sends one per period. */
#define MOST_IN_A_PERIOD 64

static void put(uint8_t *bytes, uint64_t value, int count)
{
    for (int i = 0; i < count; i++)
        bytes[i] = (uint8_t)(value >> (8 * i));
}

static uint64_t get(const uint8_t *bytes, int count)
{
    uint64_t value = 0;
    for (int i = 0; i < count; i++)
        value |= (uint64_t)bytes[i] << (8 * i);
    return value;
}

static uint64_t bits_of(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof(bits));
    return bits;
}

static double value_of(uint64_t bits)
{
    double value;
    memcpy(&value, &bits, sizeof(value));
    return value;
}

/* CRC-32 of IEEE 802.3: the checksum of UDP has 16 bits and is optional, a serial line has none. */
static uint32_t checksum(const uint8_t *bytes, int count)
{
    uint32_t crc = 0xFFFFFFFFU;
    for (int i = 0; i < count; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (0xEDB88320U & (0U - (crc & 1U)));
    }
    return crc ^ 0xFFFFFFFFU;
}

static void encode(const realtime_message *message, uint8_t bytes[MESSAGE_BYTES])
{
    put(bytes, MAGIC, 4);
    put(bytes + 4, VERSION, 2);
    put(bytes + 6, message->kind, 2);
    put(bytes + 8, message->sequence, 4);
    put(bytes + 12, message->tick, 4);
    put(bytes + 16, bits_of(message->first), 8);
    put(bytes + 24, bits_of(message->second), 8);
    for (int i = 0; i < 3; i++)
        put(bytes + 32 + 4 * i, message->words[i], 4);
    put(bytes + 44, message->run, 8);
    put(bytes + CHECKED, checksum(bytes, CHECKED), 4);
}

int realtime_decode(const uint8_t bytes[MESSAGE_BYTES], realtime_message *message)
{
    if (get(bytes, 4) != MAGIC || get(bytes + 4, 2) != VERSION || get(bytes + CHECKED, 4) != checksum(bytes, CHECKED))
        return 0;
    message->kind = (uint32_t)get(bytes + 6, 2);
    message->sequence = (uint32_t)get(bytes + 8, 4);
    message->tick = (uint32_t)get(bytes + 12, 4);
    message->first = value_of(get(bytes + 16, 8));
    message->second = value_of(get(bytes + 24, 8));
    for (int i = 0; i < 3; i++)
        message->words[i] = (uint32_t)get(bytes + 32 + 4 * i, 4);
    message->run = get(bytes + 44, 8);
    return 1;
}

/* Whether a message belongs to the present run. A controller takes the number from the first sample. A command that
 * moves the arm must return it, so that a command from before a stop, late or replayed, moves nothing; controllers
 * introduce themselves by idle commands, and a stop from one that has received no sample yet does no harm. */
static int of_this_run(realtime_channel *channel, const realtime_message *message)
{
    if (message->kind == MESSAGE_SAMPLE && channel->run == 0U)
        channel->run = message->run;
    const uint32_t mode = message->words[0];
    const int harmless = message->kind == MESSAGE_COMMAND && message->run == 0U &&
                         (mode == ARM_MODE_IDLE || mode == ARM_MODE_OFF);
    return message->run == channel->run || harmless;
}

void realtime_next_run(realtime_channel *channel)
{
    channel->former = channel->run;
    channel->kept = 0;
    channel->taken = 0U;
    /* Random, so that no recorded number is repeated; without randomness the next number is still a different one. */
    if (getrandom(&channel->run, sizeof(channel->run), GRND_NONBLOCK) != (ssize_t)sizeof(channel->run))
        channel->run = channel->former + (uint64_t)realtime_now(NULL);
    channel->run += channel->run == 0U;
}

int realtime_newest(realtime_channel *channel, uint32_t kind, realtime_message *message)
{
    uint8_t bytes[MESSAGE_BYTES];
    realtime_message each;
    int found = 0;
    for (int i = 0; i < MOST_IN_A_PERIOD && channel->receive(channel, bytes) > 0; i++) {
        const int readable = realtime_decode(bytes, &each) && each.kind == kind;
        /* A stop is sent three times for safety; the second and third belong to a run that has ended. */
        if (readable && kind == MESSAGE_COMMAND && each.words[0] == ARM_MODE_OFF && each.run != 0U &&
            each.run == channel->former)
            continue;
        if (!readable || !of_this_run(channel, &each)) {
            channel->rejected++;
            continue;
        }
        /* The difference of the sequence numbers, so that the count may wrap around. A late message must not replace
         * a newer one. */
        const int32_t newer = channel->taken == 0U ? 1 : (int32_t)(each.sequence - channel->taken);
        channel->rejected += newer < 0;
        if (newer <= 0)
            continue;
        channel->taken = each.sequence;
        /* A stop does not connect its sender: a controller sends it when it leaves. */
        channel->kept |= kind == MESSAGE_COMMAND && each.words[0] != ARM_MODE_OFF;
        *message = each;
        found = 1;
    }
    return found;
}

static int read_sample(void *self, realtime_sample *sample)
{
    realtime_message message;
    if (!realtime_newest((realtime_channel *)self, MESSAGE_SAMPLE, &message))
        return 0;
    sample->period_ns = message.words[0];
    sample->value.motor_angle = message.first;
    sample->value.torque = message.second;
    return 1;
}

int realtime_send(realtime_channel *channel, realtime_message *message)
{
    uint8_t bytes[MESSAGE_BYTES];
    message->sequence = ++channel->sent;
    message->run = channel->run;
    if (channel->is_arm && !channel->kept)
        return 0;
    encode(message, bytes);
    return channel->send(channel, bytes);
}

static int write_command(void *self, const arm_command *command)
{
    realtime_message message = {.kind = MESSAGE_COMMAND,
                                .tick = command->tick,
                                .first = command->motor_reference,
                                .second = command->voltage,
                                .words = {command->mode, command->reason, command->flags}};
    return realtime_send((realtime_channel *)self, &message);
}

realtime_io realtime_io_of(realtime_channel *channel)
{
    /* A tag needs the interpreter, for which a fault handler cannot wait. */
    const realtime_io io = {channel, 1, channel->seal == NULL, read_sample, write_command};
    return io;
}

#endif
