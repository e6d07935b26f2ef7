/* The plant's binary, by the platform's loader. */
#if !defined _WIN32 && !defined _GNU_SOURCE
#define _GNU_SOURCE /* RTLD_LOCAL and dlerror in every libc */
#endif
#include <stdio.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

#include "plant.h"

/* Where an FMU has its binary for the platform that this is compiled for: folder and suffix. */
#if defined _WIN32
#define SUFFIX ".dll"
#define PLATFORM "win64"
#elif defined __APPLE__
#define SUFFIX ".dylib"
#if defined __aarch64__
#define PLATFORM "aarch64-darwin"
#else
#define PLATFORM "darwin64"
#endif
#else
#define SUFFIX ".so"
#if defined __aarch64__
#define PLATFORM "aarch64-linux"
#else
#define PLATFORM "linux64"
#endif
#endif

/* A format for the path of the binary in its FMU, of the model's identifier. */
const char *plant_library_path(void)
{
    return "/binaries/" PLATFORM "/%s" SUFFIX;
}

#ifdef _WIN32
void *plant_library_open(const char *path, char *words, size_t n_words)
{
    wchar_t wide[32768]; /* no path is longer there */
    HMODULE library = NULL;
    if (MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, sizeof wide / sizeof *wide) > 0) {
        for (wchar_t *c = wide; *c; c++)
            if (*c == L'/')
                *c = L'\\'; /* the altered search path takes no others */
        library = LoadLibraryExW(wide, NULL, LOAD_WITH_ALTERED_SEARCH_PATH); /* what it needs may lie beside it */
    }
    if (!library)
        snprintf(words, n_words, "error %lu of LoadLibrary for %s", (unsigned long)GetLastError(), path);
    return library;
}

void *plant_library_symbol(void *library, const char *name)
{
    void *found;
    FARPROC address = GetProcAddress(library, name);
    memcpy(&found, &address, sizeof found);
    return found;
}

void plant_library_close(void *library)
{
    FreeLibrary(library);
}
#else
void *plant_library_open(const char *path, char *words, size_t n_words)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        const char *why = dlerror();
        snprintf(words, n_words, "%s", why ? why : path);
    }
    return library;
}

void *plant_library_symbol(void *library, const char *name)
{
    return dlsym(library, name);
}

void plant_library_close(void *library)
{
    dlclose(library);
}
#endif
