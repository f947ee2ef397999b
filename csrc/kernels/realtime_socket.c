/* Messages as UDP datagrams. The socket is opened and closed in Python, which reports errors by name. */
#define _GNU_SOURCE
#include "realtime.h"

#ifdef __linux__

#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

typedef struct {
    realtime_channel base;
    struct sockaddr_storage peer; /* at an arm: its controller, or the last sender that may become it */
    socklen_t peer_size;
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
    memcpy(room, bytes, MESSAGE_BYTES);
    if (self->seal != NULL && self->seal(self->sealer, bytes, room + MESSAGE_BYTES) != 0)
        return 1;
    const ssize_t sent = self->is_arm ? sendto(self->file, room, size, MSG_DONTWAIT | MSG_NOSIGNAL,
                                            (const struct sockaddr *)&c->peer, c->peer_size)
                                   : send(self->file, room, size, MSG_DONTWAIT | MSG_NOSIGNAL);
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

static int receive_datagram(realtime_channel *self, uint8_t bytes[MESSAGE_BYTES])
{
    socket_channel *const c = (socket_channel *)self;
    uint8_t room[MESSAGE_BYTES + MESSAGE_TAG + 1]; /* one byte more, so that a longer datagram is recognised */
    for (int i = 0; i < 64; i++) {
        struct sockaddr_storage sender = {0}; /* compared with its padding */
        socklen_t sender_size = sizeof(sender);
        const ssize_t size =
            recvfrom(self->file, room, sizeof(room), MSG_DONTWAIT, (struct sockaddr *)&sender, &sender_size);
        if (size < 0)
            return 0; /* nothing there, or the last datagram found no listener, which the silence will show */
        const int other = sender_size != c->peer_size || memcmp(&sender, &c->peer, sender_size) != 0;
        if (size != (ssize_t)datagram_size(self) || (self->kept && other) || !sealed(self, room)) {
            self->rejected++;
            continue;
        }
        c->peer = sender;
        c->peer_size = sender_size;
        memcpy(bytes, room, MESSAGE_BYTES);
        return 1;
    }
    return 0;
}

realtime_channel *realtime_open_socket(int file, int is_arm)
{
    socket_channel *const c = calloc(1, sizeof(*c));
    if (c == NULL)
        return NULL;
    c->base.send = send_datagram;
    c->base.receive = receive_datagram;
    c->base.file = file;
    c->base.is_arm = is_arm;
    return &c->base;
}

#endif
