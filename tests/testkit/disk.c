/* A disk that is full, and a log of what is written to it: calls of the C library on files below a folder, preloaded (LD_PRELOAD).

   disk_arm(folder, sound, stays, log): from now on the calls that take room (write, create, mkdir, rename, fsync, growing) are counted.
   The first `sound` of them succeed; the next fails with ENOSPC, and with `stays` all after it, the first of them after half
   of its bytes where it is a write. log >= 0: a file to which each change is written: kind, two numbers, two paths, bytes. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static char root[4096];
static atomic_long counted;
static long sound_calls;
static int keeps_failing, log_file = -1;
static atomic_flag busy = ATOMIC_FLAG_INIT;

void disk_arm(const char *folder, long sound, int stays, int log)
{
    atomic_store(&counted, 0);
    sound_calls = sound, keeps_failing = stays, log_file = log;
    snprintf(root, sizeof root, "%s", folder);
}

long disk_count(void) { return atomic_load(&counted); }

static void note(char kind, long a, long b, const char *path, const char *to, const void *data, size_t size)
{
    char head[9000];
    if (log_file < 0)
        return;
    int length = snprintf(head, sizeof head, "%c\t%ld\t%ld\t%s\t%s\t%zu\n", kind, a, b, path, to, size);
    while (atomic_flag_test_and_set(&busy)) {}
    syscall(SYS_write, log_file, head, (size_t)length);
    if (size)
        syscall(SYS_write, log_file, data, size);
    atomic_flag_clear(&busy);
}

void disk_mark(long number) { note('K', number, 0, "", "", NULL, 0); }

__attribute__((constructor)) static void from_environment(void)
{
    const char *folder = getenv("DISK_FOLDER"), *log = getenv("DISK_LOG"), *sound = getenv("DISK_SOUND");
    if (folder && *folder)
        disk_arm(folder, sound ? atol(sound) : 1L << 60, 1,
                 log ? (int)syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND, 0644) : -1);
}

static int below(const char *path)
{
    size_t n = strlen(root);
    return n && !strncmp(path, root, n) && (path[n] == '/' || !path[n]);
}

static int name_of_fd(int fd, char *path)
{
    char link[64];
    if (!*root || fd < 3)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, 4095);
    path[n < 0 ? 0 : n] = 0;
    return n > 0 && below(path) && !(n > 10 && !strcmp(path + n - 10, " (deleted)"));
}

static int name_at(int at, const char *given, char *path)
{
    char link[64], folder[4096];
    if (!*root)
        return 0;
    if (*given == '/') {
        snprintf(path, 4096, "%s", given);
    } else {
        snprintf(link, sizeof link, at == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d", at);
        ssize_t n = readlink(link, folder, sizeof folder - 1);
        folder[n < 0 ? 0 : n] = 0;
        if (snprintf(path, 4096, "%s/%s", folder, given) >= 4096)
            return 0;
    }
    return below(path);
}

static int full(void) /* 0, or 1 for the first that fails, 2 for those after it */
{
    long now = atomic_fetch_add(&counted, 1);
    if (now < sound_calls || (now > sound_calls && !keeps_failing))
        return 0;
    errno = ENOSPC;
    return now == sound_calls ? 1 : 2;
}

static int opened(int at, const char *given, int flags, mode_t mode)
{
    char path[4096];
    struct stat held;
    int there = 1, mine = (flags & (O_CREAT | O_TRUNC)) && name_at(at, given, path);
    if (mine) {
        there = fstatat(at, given, &held, 0) == 0;
        if (!there && full())
            return -1;
    }
    int fd = (int)syscall(SYS_openat, at, given, flags | O_LARGEFILE, mode);
    if (mine && fd >= 0 && !there)
        note('C', 0, 0, path, "", NULL, 0);
    if (mine && fd >= 0 && there && (flags & O_TRUNC))
        note('T', 0, 0, path, "", NULL, 0);
    return fd;
}

#define OPEN(name)                                                                                                     \
    int name(const char *path, int flags, ...)                                                                         \
    {                                                                                                                  \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = (flags & (O_CREAT | __O_TMPFILE)) ? va_arg(rest, mode_t) : 0;                                    \
        va_end(rest);                                                                                                  \
        return opened(AT_FDCWD, path, flags, mode);                                                                    \
    }
#define OPENAT(name)                                                                                                   \
    int name(int at, const char *path, int flags, ...)                                                                 \
    {                                                                                                                  \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = (flags & (O_CREAT | __O_TMPFILE)) ? va_arg(rest, mode_t) : 0;                                    \
        va_end(rest);                                                                                                  \
        return opened(at, path, flags, mode);                                                                          \
    }
OPEN(open)
OPEN(open64)
OPENAT(openat)
OPENAT(openat64)
int creat(const char *path, mode_t mode) { return opened(AT_FDCWD, path, O_CREAT | O_WRONLY | O_TRUNC, mode); }
int creat64(const char *path, mode_t mode) { return opened(AT_FDCWD, path, O_CREAT | O_WRONLY | O_TRUNC, mode); }

static ssize_t written(int fd, const void *data, size_t size, off64_t at)
{
    char path[4096];
    int mine = name_of_fd(fd, path), failed = mine ? full() : 0;
    if (failed == 1 && keeps_failing && size > 1)
        size /= 2;
    else if (failed)
        return -1;
    ssize_t done = at < 0 ? syscall(SYS_write, fd, data, size) : syscall(SYS_pwrite64, fd, data, size, at);
    if (mine && done > 0)
        note('W', at < 0 ? lseek(fd, 0, SEEK_CUR) - done : at, 0, path, "", data, (size_t)done);
    return done;
}

ssize_t write(int fd, const void *data, size_t size) { return written(fd, data, size, -1); }
ssize_t pwrite(int fd, const void *data, size_t size, off_t at) { return written(fd, data, size, at); }
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) { return written(fd, data, size, at); }

ssize_t writev(int fd, const struct iovec *parts, int count)
{
    char path[4096];
    if (!name_of_fd(fd, path))
        return syscall(SYS_writev, fd, parts, count);
    return count ? written(fd, parts[0].iov_base, parts[0].iov_len, -1) : 0;
}

/* these fall back to plain writes */
ssize_t sendfile(int out, int in, off_t *at, size_t size)
{
    char path[4096];
    if (name_of_fd(out, path)) {
        errno = ENOTSOCK;
        return -1;
    }
    return syscall(SYS_sendfile, out, in, at, size);
}
ssize_t sendfile64(int out, int in, off64_t *at, size_t size) { return sendfile(out, in, (off_t *)at, size); }

static int grown(int fd, const char *path, off64_t size, int mine)
{
    struct stat held;
    if (mine && (fd < 0 ? stat(path, &held) : fstat(fd, &held)) == 0 && size > held.st_size && full())
        return -1;
    int done = (int)(fd < 0 ? syscall(SYS_truncate, path, size) : syscall(SYS_ftruncate, fd, size));
    if (mine && done == 0)
        note('T', size, 0, path, "", NULL, 0);
    return done;
}

int ftruncate(int fd, off_t size) { char path[4096]; int mine = name_of_fd(fd, path); return grown(fd, path, size, mine); }
int ftruncate64(int fd, off64_t size) { return ftruncate(fd, size); }
int truncate(const char *given, off_t size)
{
    char path[4096];
    int mine = name_at(AT_FDCWD, given, path);
    return grown(-1, mine ? path : given, size, mine);
}
int truncate64(const char *given, off64_t size) { return truncate(given, size); }
int posix_fallocate(int fd, off_t at, off_t size) { return ftruncate(fd, at + size) ? errno : 0; }
int posix_fallocate64(int fd, off64_t at, off64_t size) { return posix_fallocate(fd, at, size); }

static int synced(int fd, int number)
{
    char path[4096];
    int mine = name_of_fd(fd, path);
    if (mine && full())
        return -1;
    int done = (int)syscall(number, fd);
    if (mine && done == 0)
        note('S', 0, 0, path, "", NULL, 0);
    return done;
}

int fsync(int fd) { return synced(fd, SYS_fsync); }
int fdatasync(int fd) { return synced(fd, SYS_fdatasync); }

int renameat(int from_at, const char *from, int to_at, const char *to)
{
    char one[4096], other[4096];
    struct stat held;
    int mine = name_at(to_at, to, other) && name_at(from_at, from, one);
    if (mine && fstatat(to_at, to, &held, 0) != 0 && full()) /* a name that is there takes no room */
        return -1;
    int done = (int)syscall(SYS_renameat2, from_at, from, to_at, to, 0);
    if (mine && done == 0)
        note('R', 0, 0, one, other, NULL, 0);
    return done;
}
int rename(const char *from, const char *to) { return renameat(AT_FDCWD, from, AT_FDCWD, to); }

int link(const char *from, const char *to)
{
    char one[4096], other[4096];
    int mine = name_at(AT_FDCWD, to, other) && name_at(AT_FDCWD, from, one);
    if (mine && full())
        return -1;
    int done = (int)syscall(SYS_linkat, AT_FDCWD, from, AT_FDCWD, to, 0);
    if (mine && done == 0)
        note('L', 0, 0, one, other, NULL, 0);
    return done;
}
int linkat(int from_at, const char *from, int to_at, const char *to, int flags)
{
    return from_at == AT_FDCWD && to_at == AT_FDCWD ? link(from, to) : (int)syscall(SYS_linkat, from_at, from, to_at, to, flags);
}

int mkdirat(int at, const char *given, mode_t mode)
{
    char path[4096];
    struct stat held;
    int mine = name_at(at, given, path);
    if (mine && fstatat(at, given, &held, 0) != 0 && full())
        return -1;
    int done = (int)syscall(SYS_mkdirat, at, given, mode);
    if (mine && done == 0)
        note('M', 0, 0, path, "", NULL, 0);
    return done;
}
int mkdir(const char *given, mode_t mode) { return mkdirat(AT_FDCWD, given, mode); }

int unlinkat(int at, const char *given, int flags)
{
    char path[4096];
    int mine = name_at(at, given, path), done = (int)syscall(SYS_unlinkat, at, given, flags);
    if (mine && done == 0)
        note('U', 0, 0, path, "", NULL, 0);
    return done;
}
int unlink(const char *given) { return unlinkat(AT_FDCWD, given, 0); }
int rmdir(const char *given) { return unlinkat(AT_FDCWD, given, AT_REMOVEDIR); }
