/* PythonFMU's library: found beside this one, its functions by their names. */
#ifndef _WIN32
#define _GNU_SOURCE /* dladdr */
#endif
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#define LIBRARY "pythonfmu-export.dll"
#else
#include <dlfcn.h>
#define LIBRARY "libpythonfmu-export.so"
#endif

#include "relay.h"

static const int here = 0; /* an address in this library */

#ifdef _WIN32
static bool own_path(char path[PATH_BYTES])
{
    HMODULE module;
    return GetModuleHandleExA(GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT,
                              (LPCSTR)&here, &module) &&
           GetModuleFileNameA(module, path, PATH_BYTES) < PATH_BYTES;
}

static void *open_library(const char *path)
{
    return LoadLibraryA(path);
}

static void *symbol(void *library, const char *name)
{
    void *found;
    FARPROC address = GetProcAddress(library, name);
    memcpy(&found, &address, sizeof found);
    return found;
}

void close_library(void *library)
{
    FreeLibrary(library);
}

bool has_python(void)
{
    return true; /* PythonFMU's DLL loads Python's by itself */
}
#else
static bool own_path(char path[PATH_BYTES])
{
    Dl_info info;
    char *full = dladdr(&here, &info) ? realpath(info.dli_fname, NULL) : NULL;
    bool fits = full && strlen(full) < PATH_BYTES;
    if (fits)
        strcpy(path, full);
    free(full);
    return fits;
}

static void *open_library(const char *path)
{
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}

static void *symbol(void *library, const char *name)
{
    return dlsym(library, name);
}

void close_library(void *library)
{
    dlclose(library);
}

bool has_python(void)
{
    return dlsym(RTLD_DEFAULT, "Py_IsInitialized") != NULL;
}
#endif

/* Cut the path behind its last separator, which stays. */
static bool cut(char *path)
{
    char *end = path + strlen(path);
    while (end > path && end[-1] != '/' && end[-1] != '\\')
        end--;
    *end = 0;
    return end > path;
}

/* The library beside this one; `resources` becomes the FMU's folder of that name, found from here: PythonFMU itself
   decodes nothing but spaces in the URI that the importer hands in. NULL where there is none. */
void *load_library(Functions *functions, char resources[PATH_BYTES + 16])
{
    char path[PATH_BYTES + sizeof LIBRARY];
    if (!own_path(path) || !cut(path))
        return NULL;
    strcpy(resources, path);
    strcat(path, LIBRARY);
    void *library = open_library(path);
    if (!library)
        return NULL;
    bool complete = true;
#define FIND(name)                                                                                                     \
    {                                                                                                                  \
        void *address = symbol(library, #name);                                                                        \
        memcpy(&functions->name, &address, sizeof address);                                                            \
        complete = complete && address;                                                                                \
    }
    EACH_FUNCTION(FIND)
#undef FIND
    for (int i = 0; i < 2 && complete; i++) { /* binaries/<platform>/ */
        resources[strlen(resources) - 1] = 0;
        complete = cut(resources);
    }
    strcat(resources, "resources");
    if (!complete) {
        close_library(library);
        return NULL;
    }
    return library;
}
