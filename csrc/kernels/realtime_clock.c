/* The machine's monotonic clock, and a virtual one on which threads take turns. */
#define _GNU_SOURCE
#include "realtime.h"

#ifdef __linux__

#include <pthread.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { MOST_THREADS = 8, STALL_SECONDS = 120 };

typedef struct {
    /* one per sleeper: only the thread whose turn it is wakes and takes the lock, for a process may freeze */
    pthread_cond_t turn;
    int used; /* until its thread has had its turn */
    int asleep;
    int64_t until;
    uint64_t order; /* number of the sleep, which decides between equal times */
} sleeper;

struct realtime_clock {
    pthread_mutex_t lock;
    int64_t now;
    int threads;
    int asleep;
    int stalled;
    uint64_t order;
    sleeper sleepers[MOST_THREADS];
};

/* The clock holds no pointers, so that processes can share its memory. */
static realtime_clock *mapped(int file)
{
    const int flags = file < 0 ? MAP_SHARED | MAP_ANONYMOUS : MAP_SHARED;
    void *const memory = mmap(NULL, sizeof(realtime_clock), PROT_READ | PROT_WRITE, flags, file, 0);
    return memory == MAP_FAILED ? NULL : memory;
}

realtime_clock *realtime_clock_open(int threads, int file)
{
    pthread_mutexattr_t mutex;
    pthread_condattr_t condition;
    if (file >= 0 && ftruncate(file, (off_t)sizeof(realtime_clock)) != 0)
        return NULL;
    realtime_clock *const clock = mapped(file);
    if (clock == NULL || threads == 0)
        return clock;
    pthread_mutexattr_init(&mutex);
    pthread_mutexattr_setpshared(&mutex, PTHREAD_PROCESS_SHARED);
    pthread_mutex_init(&clock->lock, &mutex);
    pthread_condattr_init(&condition);
    pthread_condattr_setpshared(&condition, PTHREAD_PROCESS_SHARED);
    for (int i = 0; i < MOST_THREADS; i++)
        pthread_cond_init(&clock->sleepers[i].turn, &condition);
    clock->threads = threads;
    return clock;
}

/* Neither mutex nor condition is destroyed: another process may wait in them, and they hold no resources. */
void realtime_clock_close(realtime_clock *clock)
{
    munmap(clock, sizeof(*clock));
}

/* If all threads are asleep, wake the one whose time comes first. */
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
    pthread_cond_signal(&first->turn);
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
    me->used = me->asleep = 1;
    me->until = time_ns;
    me->order = ++clock->order;
    clock->asleep++;
    pass_on(clock);
    while (me->asleep && !clock->stalled)
        clock->stalled |= pthread_cond_timedwait(&me->turn, &clock->lock, &limit) != 0 && me->asleep;
    if (me->asleep) { /* an error in one thread must not hang another: let time run, and the test fail */
        me->asleep = 0;
        clock->asleep--;
        clock->now = time_ns > clock->now ? time_ns : clock->now;
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
