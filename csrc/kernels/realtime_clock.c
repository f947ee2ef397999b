/* The machine's monotonic clock, and a virtual one on which threads take turns. */
#define _GNU_SOURCE
#include "realtime.h"

#ifdef __linux__

#include <pthread.h>
#include <stdlib.h>
#include <time.h>

enum { MOST_THREADS = 8, STALL_SECONDS = 30 };

typedef struct {
    int used; /* until its thread has seen its turn */
    int asleep;
    int64_t until;
    uint64_t order; /* of falling asleep, which decides between equal times */
} sleeper;

struct realtime_clock {
    pthread_mutex_t lock;
    pthread_cond_t turn;
    int64_t now;
    int threads;
    int asleep;
    int stalled;
    uint64_t order;
    sleeper sleepers[MOST_THREADS];
};

realtime_clock *realtime_clock_open(int threads)
{
    realtime_clock *const clock = calloc(1, sizeof(*clock));
    if (clock == NULL)
        return NULL;
    pthread_mutex_init(&clock->lock, NULL);
    pthread_cond_init(&clock->turn, NULL);
    clock->threads = threads;
    return clock;
}

void realtime_clock_close(realtime_clock *clock)
{
    pthread_cond_destroy(&clock->turn);
    pthread_mutex_destroy(&clock->lock);
    free(clock);
}

/* With everybody asleep, wake the one whose time comes first. */
static void pass_on(realtime_clock *clock)
{
    sleeper *first = NULL;
    if (clock->asleep == 0 || clock->asleep < clock->threads)
        return;
    for (int i = 0; i < MOST_THREADS; i++) {
        sleeper *const each = &clock->sleepers[i];
        if (each->asleep && (first == NULL || each->until < first->until ||
                             (each->until == first->until && each->order < first->order)))
            first = each;
    }
    first->asleep = 0;
    clock->asleep--;
    clock->now = first->until > clock->now ? first->until : clock->now;
    pthread_cond_broadcast(&clock->turn);
}

void realtime_clock_leave(realtime_clock *clock)
{
    pthread_mutex_lock(&clock->lock);
    clock->threads--;
    pass_on(clock);
    pthread_mutex_unlock(&clock->lock);
}

int realtime_clock_stalled(const realtime_clock *clock)
{
    return clock->stalled;
}

static void take_turns(realtime_clock *clock, int64_t time_ns)
{
    struct timespec limit;
    int place = 0;
    clock_gettime(CLOCK_REALTIME, &limit);
    limit.tv_sec += STALL_SECONDS;
    pthread_mutex_lock(&clock->lock);
    while (place < MOST_THREADS - 1 && clock->sleepers[place].used)
        place++;
    sleeper *const me = &clock->sleepers[place];
    *me = (sleeper){1, 1, time_ns, ++clock->order};
    clock->asleep++;
    pass_on(clock);
    while (me->asleep && !clock->stalled)
        clock->stalled |= pthread_cond_timedwait(&clock->turn, &clock->lock, &limit) != 0 && me->asleep;
    if (me->asleep) { /* nobody may hang for a mistake of another: let time run, and the test fail */
        me->asleep = 0;
        clock->asleep--;
        clock->now = time_ns > clock->now ? time_ns : clock->now;
        pthread_cond_broadcast(&clock->turn);
    }
    me->used = 0;
    pthread_mutex_unlock(&clock->lock);
}

int64_t realtime_now(realtime_clock *clock)
{
    struct timespec t;
    if (clock != NULL) {
        pthread_mutex_lock(&clock->lock);
        const int64_t now = clock->now;
        pthread_mutex_unlock(&clock->lock);
        return now;
    }
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

void realtime_sleep_until(realtime_clock *clock, int64_t time_ns)
{
    const struct timespec t = {time_ns / 1000000000, time_ns % 1000000000};
    if (clock != NULL)
        take_turns(clock, time_ns);
    else
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

#endif
