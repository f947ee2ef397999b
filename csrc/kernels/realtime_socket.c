/* Messages as UDP datagrams. The socket is opened and closed in Python, which reports errors by name. */
#define _GNU_SOURCE
#include "realtime.h"

#ifdef __linux__

#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

typedef struct {
    realtime_channel base;
    int file;
    int is_arm;
    int kept;                     /* restricted to `peer` */
    struct sockaddr_storage peer; /* at an arm: its controller */
    struct sockaddr_storage last; /* sender of the last datagram */
    socklen_t peer_size;
    socklen_t last_size;
} socket_channel;

static size_t datagram_size(const realtime_channel *self)
{
    return self->seal == NULL ? MESSAGE_BYTES : MESSAGE_BYTES + MESSAGE_TAG;
}

static int send_datagram(realtime_channel *self, const uint8_t bytes[MESSAGE_BYTES])
{
    const socket_channel *const c = (const socket_channel *)self;
    const size_t size = datagram_size(self);
    uint8_t room[MESSAGE_BYTES + MESSAGE_TAG];
    if (c->is_arm && !c->kept)
        return 0;
    memcpy(room, bytes, MESSAGE_BYTES);
    if (self->seal != NULL && self->seal(self->sealer, bytes, room + MESSAGE_BYTES) != 0)
        return 1;
    const ssize_t sent = c->is_arm ? sendto(c->file, room, size, MSG_DONTWAIT | MSG_NOSIGNAL,
                                            (const struct sockaddr *)&c->peer, c->peer_size)
                                   : send(c->file, room, size, MSG_DONTWAIT | MSG_NOSIGNAL);
    return sent == (ssize_t)size ? 0 : 1;
}

/* Whether a datagram carries the tag of its bytes. Every byte is compared, so that the time reveals nothing. */
static int sealed(const realtime_channel *self, const uint8_t room[MESSAGE_BYTES + MESSAGE_TAG])
{
    uint8_t tag[MESSAGE_TAG];
    int apart = 0;
    if (self->seal == NULL)
        return 1;
    if (self->seal(self->sealer, room, tag) != 0)
        return 0;
    for (int i = 0; i < MESSAGE_TAG; i++)
        apart |= tag[i] ^ room[MESSAGE_BYTES + i];
    return apart == 0;
}

static int same(const socket_channel *c)
{
    return c->last_size == c->peer_size && memcmp(&c->last, &c->peer, c->peer_size) == 0;
}

static int receive_datagram(realtime_channel *self, uint8_t bytes[MESSAGE_BYTES])
{
    socket_channel *const c = (socket_channel *)self;
    uint8_t room[MESSAGE_BYTES + MESSAGE_TAG + 1]; /* one byte more, so that a longer datagram is recognised */
    for (int i = 0; i < 64; i++) {
        c->last_size = sizeof(c->last);
        memset(&c->last, 0, sizeof(c->last)); /* `same` compares bytes including padding */
        const ssize_t size =
            recvfrom(c->file, room, sizeof(room), MSG_DONTWAIT, (struct sockaddr *)&c->last, &c->last_size);
        if (size < 0)
            return 0; /* nothing there, or the last datagram found no listener, which the silence will show */
        if (size != (ssize_t)datagram_size(self) || (c->kept && !same(c)) || !sealed(self, room)) {
            self->rejected++;
            continue;
        }
        memcpy(bytes, room, MESSAGE_BYTES);
        return 1;
    }
    return 0;
}

static void keep_sender(realtime_channel *self)
{
    socket_channel *const c = (socket_channel *)self;
    c->peer = c->last;
    c->peer_size = c->last_size;
    c->kept = 1;
}

static void forget_sender(realtime_channel *self)
{
    ((socket_channel *)self)->kept = 0;
    self->taken = 0U;
}

static void close_socket(realtime_channel *self)
{
    free(self);
}

realtime_channel *realtime_open_socket(int file, int is_arm)
{
    socket_channel *const c = calloc(1, sizeof(*c));
    if (c == NULL)
        return NULL;
    c->base.send = send_datagram;
    c->base.receive = receive_datagram;
    c->base.keep = keep_sender;
    c->base.forget = forget_sender;
    c->base.close = close_socket;
    c->file = file;
    c->is_arm = is_arm;
    return &c->base;
}

#endif
