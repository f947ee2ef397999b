/* What real time needs from the process: its clock, signals that end a run in order, priority, and locked memory. */
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

#define STACK_BYTES 65536 /* the deepest call of a period needs about 2 kB, a Python callback needs more */

/* ---- the clock ---- */

int64_t realtime_now(const realtime_clock *clock)
{
    struct timespec t;
    if (clock != NULL)
        return clock->now(clock->self);
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

void realtime_sleep_until(const realtime_clock *clock, int64_t time_ns)
{
    const struct timespec t = {time_ns / 1000000000, time_ns % 1000000000};
    if (clock != NULL)
        clock->sleep_until(clock->self, time_ns);
    else
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

/* ---- signals ---- */

/* A signal handler can only access a static object. */
static volatile sig_atomic_t caught;
static const realtime_io *volatile faulting_io;
static const arm_command *volatile faulting_stop;
static struct sigaction former[NSIG];
static int taken[NSIG];
/* Stack of the fault handler: endless recursion leaves no space on the loop's own stack. There is one for the
 * process; with several loops in threads a fault stops only one of them. */
static unsigned char fault_stack[STACK_BYTES];
static _Thread_local stack_t former_stack;
static int watchers;
static pthread_mutex_t watchers_lock = PTHREAD_MUTEX_INITIALIZER;

static void note(int number)
{
    caught = number;
}

/* The process is about to die of its own fault, and only this code can still be trusted: one last stop, then the fault
 * acts as if it had not been caught. A second fault in here reaches the former handler. */
static void stop_and_fall(int number)
{
    const realtime_io *const io = faulting_io;
    sigaction(number, &former[number], NULL);
    if (io != NULL)
        io->write(io->self, faulting_stop);
    raise(number);
}

void realtime_stop_on_fault(const realtime_io *io, const arm_command *stop)
{
    /* Assigned to the calling thread, which runs the loop; restored afterwards, since faulthandler has its own. */
    const stack_t own = {.ss_sp = fault_stack, .ss_size = sizeof(fault_stack)};
    if (io != NULL)
        sigaltstack(&own, &former_stack);
    else
        sigaltstack(&former_stack, NULL);
    faulting_io = NULL;
    faulting_stop = stop;
    faulting_io = io != NULL && io->direct ? io : NULL;
}

static int is_fault(int number)
{
    return number == SIGSEGV || number == SIGBUS || number == SIGFPE || number == SIGILL || number == SIGABRT ||
           number == SIGTRAP || number == SIGSYS;
}

/* Whether a signal is to end the run: Ctrl-C, Ctrl-\, Ctrl-Z, a closed terminal and SIGTERM, whatever Python does
 * with them; and every other one whose default would end or stop the process, unless the program has its own use for
 * it. Ignored signals stay ignored, as nohup requires. */
static int ends_the_run(int number, const struct sigaction *before)
{
    if (before->sa_handler == SIG_IGN)
        return 0;
    switch (number) {
    case SIGINT:
    case SIGTERM:
    case SIGHUP:
    case SIGQUIT:
    case SIGTSTP:
        return 1;
    case SIGKILL: /* these two cannot be caught, */
    case SIGSTOP:
    case SIGCHLD: /* and these end no process by default */
    case SIGCONT:
    case SIGURG:
    case SIGWINCH:
        return 0;
    default:
        return before->sa_handler == SIG_DFL;
    }
}

void realtime_watch_signals(void)
{
    pthread_mutex_lock(&watchers_lock);
    if (watchers++ == 0) {
        struct sigaction action;
        memset(&action, 0, sizeof(action));
        caught = 0;
        for (int i = 1; i < NSIG; i++) {
            if (sigaction(i, NULL, &former[i]) != 0)
                continue; /* reserved by the C library */
            taken[i] = is_fault(i) || ends_the_run(i, &former[i]);
            action.sa_handler = is_fault(i) ? stop_and_fall : note; /* without SA_RESTART: a sleeping loop wakes up */
            action.sa_flags = is_fault(i) ? SA_ONSTACK : 0;
            if (taken[i])
                taken[i] = sigaction(i, &action, NULL) == 0;
        }
    }
    pthread_mutex_unlock(&watchers_lock);
}

void realtime_release_signals(void)
{
    pthread_mutex_lock(&watchers_lock);
    if (--watchers == 0)
        for (int i = 1; i < NSIG; i++)
            if (taken[i])
                sigaction(i, &former[i], NULL);
    pthread_mutex_unlock(&watchers_lock);
}

int realtime_signalled(void)
{
    return caught;
}

/* ---- privileges ---- */

/* Pages are locked from their first use on. All of them at once would be a gigabyte with numpy loaded: stacks and
 * arenas of threads that never run. The first use of a page in the loop costs a microsecond; a page that was swapped
 * to disk would cost milliseconds, and is avoided. */
#ifdef MCL_ONFAULT
#define KEPT (MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT)
#else
#define KEPT (MCL_CURRENT | MCL_FUTURE)
#endif

/* Touch the stack that the loop will use, so that none of its pages is missing in a period. */
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
    /* An ordinary thread may be woken 50 us late to save power; SCHED_FIFO has no such slack. */
    prctl(PR_SET_TIMERSLACK, 1UL);
    if (priority > 0) {
        parameters.sched_priority = priority;
        before.priority_error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters);
        before.scheduled = before.priority_error == 0;
    }
    if (lock_memory) {
        before.locked = mlockall(KEPT) == 0;
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
