/* Messages in shared memory: one slot for samples, one for commands, each under a sequence lock, so that neither side
 * can make the other wait. */
#define _GNU_SOURCE
#include "realtime.h"

#ifdef __linux__

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#define WORDS (MESSAGE_BYTES / 8)
/* A writer is inside for some 20 ns; one that died there leaves its slot odd for ever, and the reader must go on. */
#define MOST_TRIALS 1000

typedef struct {
    _Atomic uint32_t turn; /* odd while it is written */
    uint32_t spare[15];    /* a cache line of its own: polling must not slow the other slot's writer */
    _Atomic uint64_t words[WORDS];
    uint64_t rest[8 - WORDS];
} memory_slot;

typedef struct {
    memory_slot samples;
    memory_slot commands;
} memory_map;

typedef struct {
    realtime_channel base;
    memory_map *map;
    memory_slot *out;
    memory_slot *in;
    uint32_t seen; /* turn of the last message received */
} memory_channel;

static int put_message(realtime_channel *self, const uint8_t bytes[MESSAGE_BYTES])
{
    memory_slot *const slot = ((memory_channel *)self)->out;
    /* `| 1`: a writer that died inside left it odd */
    const uint32_t turn = (atomic_load_explicit(&slot->turn, memory_order_relaxed) + 1U) | 1U;
    uint64_t words[WORDS];
    memcpy(words, bytes, sizeof(words));
    atomic_store_explicit(&slot->turn, turn, memory_order_relaxed);
    atomic_thread_fence(memory_order_release);
    for (int i = 0; i < WORDS; i++)
        atomic_store_explicit(&slot->words[i], words[i], memory_order_relaxed);
    atomic_store_explicit(&slot->turn, turn + 1U, memory_order_release);
    return 0;
}

static int take_message(realtime_channel *self, uint8_t bytes[MESSAGE_BYTES])
{
    memory_channel *const c = (memory_channel *)self;
    uint64_t words[WORDS];
    for (int trial = 0; trial < MOST_TRIALS; trial++) {
        const uint32_t turn = atomic_load_explicit(&c->in->turn, memory_order_acquire);
        if (turn == c->seen)
            return 0;
        if (turn & 1U)
            continue;
        for (int i = 0; i < WORDS; i++)
            words[i] = atomic_load_explicit(&c->in->words[i], memory_order_relaxed);
        atomic_thread_fence(memory_order_acquire);
        if (atomic_load_explicit(&c->in->turn, memory_order_relaxed) != turn)
            continue;
        c->seen = turn;
        memcpy(bytes, words, sizeof(words));
        return 1;
    }
    return 0;
}

static void keep_nobody(realtime_channel *self)
{
    (void)self; /* who may write is settled by a lock on the file, before it is mapped */
}

static void forget_commands(realtime_channel *self)
{
    self->taken = 0U;
}

static void close_memory(realtime_channel *self)
{
    memory_channel *const c = (memory_channel *)self;
    munmap(c->map, sizeof(memory_map));
    free(c);
}

size_t realtime_memory_size(void)
{
    return sizeof(memory_map);
}

realtime_channel *realtime_open_memory(int file, int is_arm)
{
    memory_channel *const c = calloc(1, sizeof(*c));
    if (c == NULL)
        return NULL;
    c->map = mmap(NULL, sizeof(memory_map), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (c->map == MAP_FAILED) {
        free(c);
        return NULL;
    }
    c->base.send = put_message;
    c->base.receive = take_message;
    c->base.keep = keep_nobody;
    c->base.forget = forget_commands;
    c->base.close = close_memory;
    c->out = is_arm ? &c->map->samples : &c->map->commands;
    c->in = is_arm ? &c->map->commands : &c->map->samples;
    /* What an earlier run left behind is no message of this one. */
    c->seen = atomic_load(&c->in->turn);
    return &c->base;
}

#endif
