/* A disk that is full: calls of the C library on files below a folder, preloaded (LD_PRELOAD).

   disk_arm(folder, sound, stays): from now on the calls that take room (write, create, mkdir, rename, fsync, growing) are counted.
   The first `sound` of them succeed; the next fails with ENOSPC, and with `stays` all after it, the first of them after half
   of its bytes where it is a write. */
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
static int keeps_failing;

void disk_arm(const char *folder, long sound, int stays)
{
    atomic_store(&counted, 0);
    sound_calls = sound, keeps_failing = stays;
    snprintf(root, sizeof root, "%s", folder);
}

long disk_count(void) { return atomic_load(&counted); }

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
    if ((flags & (O_CREAT | O_TRUNC)) && name_at(at, given, path) && fstatat(at, given, &held, 0) != 0 && full())
        return -1;
    return (int)syscall(SYS_openat, at, given, flags | O_LARGEFILE, mode);
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
int creat64(const char *path, mode_t mode) { return creat(path, mode); }

static ssize_t written(int fd, const void *data, size_t size, off64_t at)
{
    char path[4096];
    int failed = name_of_fd(fd, path) ? full() : 0;
    if (failed == 1 && keeps_failing && size > 1)
        size /= 2;
    else if (failed)
        return -1;
    return at < 0 ? syscall(SYS_write, fd, data, size) : syscall(SYS_pwrite64, fd, data, size, at);
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

int ftruncate(int fd, off_t size)
{
    char path[4096];
    struct stat held;
    if (name_of_fd(fd, path) && fstat(fd, &held) == 0 && size > held.st_size && full())
        return -1;
    return (int)syscall(SYS_ftruncate, fd, size);
}
int ftruncate64(int fd, off64_t size) { return ftruncate(fd, size); }
int truncate(const char *given, off_t size)
{
    char path[4096];
    struct stat held;
    if (name_at(AT_FDCWD, given, path) && stat(given, &held) == 0 && size > held.st_size && full())
        return -1;
    return (int)syscall(SYS_truncate, given, size);
}
int truncate64(const char *given, off64_t size) { return truncate(given, size); }
int posix_fallocate(int fd, off_t at, off_t size) { return ftruncate(fd, at + size) ? errno : 0; }
int posix_fallocate64(int fd, off64_t at, off64_t size) { return posix_fallocate(fd, at, size); }

static int synced(int fd, int number)
{
    char path[4096];
    return name_of_fd(fd, path) && full() ? -1 : (int)syscall(number, fd);
}

int fsync(int fd) { return synced(fd, SYS_fsync); }
int fdatasync(int fd) { return synced(fd, SYS_fdatasync); }

/* a name that is there takes no room */
static int takes_room(int at, const char *name)
{
    char path[4096];
    struct stat held;
    return name_at(at, name, path) && fstatat(at, name, &held, 0) != 0;
}

int renameat(int from_at, const char *from, int to_at, const char *to)
{
    char path[4096];
    if (takes_room(to_at, to) && name_at(from_at, from, path) && full())
        return -1;
    return (int)syscall(SYS_renameat2, from_at, from, to_at, to, 0);
}
int rename(const char *from, const char *to) { return renameat(AT_FDCWD, from, AT_FDCWD, to); }

int linkat(int from_at, const char *from, int to_at, const char *to, int flags)
{
    if (takes_room(to_at, to) && full())
        return -1;
    return (int)syscall(SYS_linkat, from_at, from, to_at, to, flags);
}
int link(const char *from, const char *to) { return linkat(AT_FDCWD, from, AT_FDCWD, to, 0); }

int mkdirat(int at, const char *given, mode_t mode)
{
    if (takes_room(at, given) && full())
        return -1;
    return (int)syscall(SYS_mkdirat, at, given, mode);
}
int mkdir(const char *given, mode_t mode) { return mkdirat(AT_FDCWD, given, mode); }
