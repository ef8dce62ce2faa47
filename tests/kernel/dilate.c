/* A slower clock for the programs of the guest: an hour of its kernel is 1/DILATE of an hour to them.

   In virtual time an instruction takes a nanosecond, a tenth of the speed of the processors that this runs on: the programs' own
   time has to go slower in proportion. Preloaded, this divides what every clock says, and multiplies what is asked
   of waits. It keeps no state, so all processes agree and none of them can die with a lock (libfaketime's do). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/select.h>
#include <sys/time.h>
#include <time.h>

#define REAL(name, version)                                                                                       \
    static __typeof__(&name) real;                                                                                \
    if (!real)                                                                                                    \
        real = (__typeof__(&name))dlvsym(RTLD_NEXT, #name, version)

typedef __int128 wide;
static const long BILLION = 1000000000L;

static long factor(void) {
    static long found;
    if (!found) {
        const char *text = getenv("DILATE");
        long value = text ? atol(text) : 1;
        found = value > 0 ? value : 1;
    }
    return found;
}

static struct timespec from_ns(wide ns) {
    return (struct timespec){.tv_sec = (time_t)(ns / BILLION), .tv_nsec = (long)(ns % BILLION)};
}

static wide ns_of(const struct timespec *t) { return (wide)t->tv_sec * BILLION + t->tv_nsec; }

/* Durations and moments alike: all clocks are divided. */
static const struct timespec *longer(const struct timespec *t, struct timespec *room) {
    if (!t || t->tv_sec < 0 || t->tv_nsec < 0 || t->tv_nsec >= BILLION)
        return t;
    *room = from_ns(ns_of(t) * factor());
    return room;
}

static int longer_ms(int ms) {
    long all = (long)ms * factor();
    return ms <= 0 ? ms : all > INT_MAX ? INT_MAX : (int)all;
}

static struct timeval longer_us(const struct timeval *t) {
    long all = (t->tv_sec * 1000000L + t->tv_usec) * factor();
    return (struct timeval){.tv_sec = all / 1000000L, .tv_usec = all % 1000000L};
}

int clock_gettime(clockid_t clock, struct timespec *t) {
    REAL(clock_gettime, "GLIBC_2.17");
    int failed = real(clock, t);
    if (!failed)
        *t = from_ns(ns_of(t) / factor());
    return failed;
}

int gettimeofday(struct timeval *restrict t, void *restrict zone) {
    (void)zone;
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    *t = (struct timeval){.tv_sec = now.tv_sec, .tv_usec = now.tv_nsec / 1000};
    return 0;
}

time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t)
        *t = now.tv_sec;
    return now.tv_sec;
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *t, struct timespec *left) {
    REAL(clock_nanosleep, "GLIBC_2.17");
    struct timespec room;
    int failed = real(clock, flags, longer(t, &room), left);
    if (failed == EINTR && left && !(flags & TIMER_ABSTIME))
        *left = from_ns(ns_of(left) / factor());
    return failed;
}

int nanosleep(const struct timespec *t, struct timespec *left) {
    int failed = clock_nanosleep(CLOCK_REALTIME, 0, t, left);
    errno = failed ? failed : errno;
    return failed ? -1 : 0;
}

int select(int n, fd_set *restrict r, fd_set *restrict w, fd_set *restrict e, struct timeval *restrict t) {
    REAL(select, "GLIBC_2.2.5");
    struct timeval wait;
    if (t)
        wait = longer_us(t);
    return real(n, r, w, e, t ? &wait : NULL);
}

int pselect(int n, fd_set *restrict r, fd_set *restrict w, fd_set *restrict e, const struct timespec *restrict t,
            const sigset_t *restrict mask) {
    REAL(pselect, "GLIBC_2.2.5");
    struct timespec room;
    return real(n, r, w, e, longer(t, &room), mask);
}

int poll(struct pollfd *files, nfds_t n, int ms) {
    REAL(poll, "GLIBC_2.2.5");
    return real(files, n, longer_ms(ms));
}

int ppoll(struct pollfd *files, nfds_t n, const struct timespec *t, const sigset_t *mask) {
    REAL(ppoll, "GLIBC_2.4");
    struct timespec room;
    return real(files, n, longer(t, &room), mask);
}

int epoll_wait(int file, struct epoll_event *events, int most, int ms) {
    REAL(epoll_wait, "GLIBC_2.3.2");
    return real(file, events, most, longer_ms(ms));
}

int sem_timedwait(sem_t *restrict sem, const struct timespec *restrict t) {
    REAL(sem_timedwait, "GLIBC_2.34");
    struct timespec room;
    return real(sem, longer(t, &room));
}

int sem_clockwait(sem_t *restrict sem, clockid_t clock, const struct timespec *restrict t) {
    REAL(sem_clockwait, "GLIBC_2.34");
    struct timespec room;
    return real(sem, clock, longer(t, &room));
}

int pthread_cond_timedwait(pthread_cond_t *restrict c, pthread_mutex_t *restrict m, const struct timespec *restrict t) {
    REAL(pthread_cond_timedwait, "GLIBC_2.3.2");
    struct timespec room;
    return real(c, m, longer(t, &room));
}

int pthread_cond_clockwait(pthread_cond_t *restrict c, pthread_mutex_t *restrict m, clockid_t clock,
                           const struct timespec *restrict t) {
    REAL(pthread_cond_clockwait, "GLIBC_2.34");
    struct timespec room;
    return real(c, m, clock, longer(t, &room));
}

int setitimer(__itimer_which_t which, const struct itimerval *restrict new, struct itimerval *restrict old) {
    REAL(setitimer, "GLIBC_2.2.5");
    struct itimerval slow = {longer_us(&new->it_interval), longer_us(&new->it_value)};
    return real(which, &slow, old);
}
