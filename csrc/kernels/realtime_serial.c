/* Messages as bytes of a serial line, one after the other. The port is opened and closed in Python, which reports
 * errors by name. A line has no datagrams: a message begins with its four characters and is valid if its checksum is
 * right. */
#include "realtime.h"

#ifdef __linux__

#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

/* What a line of 1 Mbaud carries in 0.1 s: older bytes are of no use as a sample. */
#define ROOM 10240

typedef struct {
    realtime_channel base;
    size_t held; /* bytes of an incomplete message */
    uint8_t bytes[ROOM];
} serial_channel;

static int send_bytes(realtime_channel *self, const uint8_t bytes[MESSAGE_BYTES])
{
    int waiting = 0;
    /* Queued messages would all arrive late: a controller that introduces itself sends more often than the line can
     * carry. */
    if (ioctl(self->file, TIOCOUTQ, &waiting) == 0 && waiting >= MESSAGE_BYTES)
        return 1;
    return write(self->file, bytes, MESSAGE_BYTES) == MESSAGE_BYTES ? 0 : 1;
}

static void drop(serial_channel *c, size_t count)
{
    c->held -= count;
    memmove(c->bytes, c->bytes + count, c->held);
}

/* Drop bytes that cannot begin a message; return whether a complete one is left. */
static int aligned(serial_channel *c)
{
    static const uint8_t begin[4] = {'F', 'L', 'R', 'T'};
    size_t at = 0;
    while (at < c->held && memcmp(c->bytes + at, begin, c->held - at < 4 ? c->held - at : 4) != 0)
        at++;
    drop(c, at);
    return c->held >= MESSAGE_BYTES;
}

static int receive_bytes(realtime_channel *self, uint8_t bytes[MESSAGE_BYTES])
{
    serial_channel *const c = (serial_channel *)self;
    realtime_message each;
    const ssize_t size = read(self->file, c->bytes + c->held, ROOM - c->held);
    if (size > 0)
        c->held += (size_t)size;
    while (aligned(c)) {
        const int whole = realtime_decode(c->bytes, &each);
        memcpy(bytes, c->bytes, MESSAGE_BYTES);
        /* After a damaged message the next one may begin at any byte. */
        drop(c, whole ? MESSAGE_BYTES : 1);
        if (whole)
            return 1;
        self->rejected++;
    }
    return 0;
}

realtime_channel *realtime_open_serial(int file, int is_arm)
{
    serial_channel *const c = calloc(1, sizeof(*c));
    if (c == NULL)
        return NULL;
    c->base.send = send_bytes;
    c->base.receive = receive_bytes;
    c->base.file = file;
    c->base.is_arm = is_arm;
    return &c->base;
}

#endif
