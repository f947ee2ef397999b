/* What the process needs for real time: the clock, a priority, memory that stays, and signals that end a run in order. */
#define _GNU_SOURCE
#include "realtime.h"

#ifdef __linux__

#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

#define STACK_BYTES 65536 /* the deepest call of a period needs about 2 kB, a user's library may need more */

int64_t realtime_now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

void realtime_sleep_until(int64_t time_ns)
{
    const struct timespec t = {time_ns / 1000000000, time_ns % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

/* A signal handler reaches nothing but a static object. */
static volatile sig_atomic_t caught;
static const int watched[] = {SIGINT, SIGTERM, SIGHUP};
enum { WATCHED = sizeof(watched) / sizeof(watched[0]) };
static struct sigaction former[WATCHED];
static int watchers;
static pthread_mutex_t watchers_lock = PTHREAD_MUTEX_INITIALIZER;

static void note(int number)
{
    caught = number;
}

void realtime_watch_signals(void)
{
    pthread_mutex_lock(&watchers_lock);
    if (watchers++ == 0) {
        struct sigaction action;
        memset(&action, 0, sizeof(action));
        action.sa_handler = note; /* without SA_RESTART: a sleeping loop wakes up */
        caught = 0;
        for (int i = 0; i < WATCHED; i++) {
            sigaction(watched[i], NULL, &former[i]);
            if (former[i].sa_handler != SIG_IGN) /* nohup means it */
                sigaction(watched[i], &action, NULL);
        }
    }
    pthread_mutex_unlock(&watchers_lock);
}

void realtime_release_signals(void)
{
    pthread_mutex_lock(&watchers_lock);
    if (--watchers == 0)
        for (int i = 0; i < WATCHED; i++)
            sigaction(watched[i], &former[i], NULL);
    pthread_mutex_unlock(&watchers_lock);
}

int realtime_signalled(void)
{
    return caught;
}

/* Touch the stack that the loop will use, so that no page of it is missing in a period. */
static void touch_stack(void)
{
    volatile char room[STACK_BYTES];
    for (size_t i = 0; i < sizeof(room); i += 1024)
        room[i] = 0;
}

realtime_privileges realtime_prepare(int priority, int lock_memory)
{
    realtime_privileges before = {SCHED_OTHER, 0, 0, 0, 0, 0, 0};
    struct sched_param parameters;
    pthread_getschedparam(pthread_self(), &before.policy, &parameters);
    before.priority = parameters.sched_priority;
    before.slack = prctl(PR_GET_TIMERSLACK);
    /* An ordinary thread may be woken 50 us late to save power; SCHED_FIFO knows no such slack. */
    prctl(PR_SET_TIMERSLACK, 1UL);
    if (priority > 0) {
        parameters.sched_priority = priority;
        before.priority_error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters);
        before.scheduled = before.priority_error == 0;
    }
    if (lock_memory) {
        before.locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
        before.memory_error = before.locked ? 0 : errno;
    }
    touch_stack();
    return before;
}

void realtime_relax(const realtime_privileges *before)
{
    const struct sched_param parameters = {.sched_priority = before->priority};
    if (before->locked)
        munlockall();
    if (before->scheduled)
        pthread_setschedparam(pthread_self(), before->policy, &parameters);
    prctl(PR_SET_TIMERSLACK, (unsigned long)before->slack);
}

#endif
