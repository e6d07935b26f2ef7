/* Where the plant lies: importers hand in a URI, `file:///home/a%20b/resources`, or a path, and the plant wants a URI. */
#include <string.h>

#include "plant.h"

static int hexadecimal(char c)
{
    if (c >= '0' && c <= '9')
        return c - '0';
    if (c >= 'a' && c <= 'f')
        return c - 'a' + 10;
    if (c >= 'A' && c <= 'F')
        return c - 'A' + 10;
    return -1;
}

static bool is_letter(char c)
{
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

static bool has_drive(const char *path)
{
    return is_letter(path[0]) && path[1] == ':';
}

/* Behind `file:`, `file://` and the host, if it is this one; an authority that is another stays, as Windows has it: //host/share. */
static const char *behind_scheme(const char *uri)
{
    const char *path = uri + 5;
    if (strncmp(path, "//", 2) == 0) {
        if (path[2] == '/')
            path += 2;
        else if (strncmp(path + 2, "localhost/", 10) == 0)
            path += 11;
        else if (has_drive(path + 2))
            path += 2; /* two solidi where three belong */
    }
#ifndef _WIN32
    while (path[0] == '/' && path[1] == '/')
        path++; /* four, of importers that put a path with its own behind three */
#endif
    return path[0] == '/' && has_drive(path + 1) ? path + 1 : path;
}

/* The folder `plant` in the folder of resources that the importer names. */
char *plant_folder(const char *resources, fmi2CallbackAllocateMemory allocate)
{
    static const char inside[] = "/plant";
    bool is_uri = strncmp(resources, "file:", 5) == 0;
    const char *from = is_uri ? behind_scheme(resources) : resources;
    char *folder = allocate(1, strlen(from) + sizeof inside);
    if (!folder)
        return NULL;
    size_t n = 0;
    for (; *from; from++) {
        int high = is_uri && from[0] == '%' ? hexadecimal(from[1]) : -1;
        int low = high >= 0 ? hexadecimal(from[2]) : -1;
        if (low >= 0 && high + low > 0) {
            folder[n++] = (char)(16 * high + low);
            from += 2;
        } else {
            folder[n++] = *from;
        }
    }
    while (n > 0 && (folder[n - 1] == '/' || folder[n - 1] == '\\'))
        n--;
    memcpy(folder + n, inside, sizeof inside);
    return folder;
}

/* The URI of `inside` in the folder. */
char *plant_location(const char *folder, const char *inside, fmi2CallbackAllocateMemory allocate)
{
    static const char digits[] = "0123456789ABCDEF", scheme[] = "file:///", plain[] = "-._~/:";
    char *uri = allocate(1, sizeof scheme + 3 * (strlen(folder) + strlen(inside)));
    if (!uri)
        return NULL;
    memcpy(uri, scheme, sizeof scheme - 1);
    size_t n = sizeof scheme - 1;
    if (folder[0] == '/' || folder[0] == '\\')
        n--; /* the third solidus is the path's own */
    if ((folder[0] == '/' || folder[0] == '\\') && folder[1] == folder[0])
        n -= 2; /* and of a share both */
    const char *parts[2] = {folder, inside};
    for (int i = 0; i < 2; i++) {
        for (const char *c = parts[i]; *c; c++) {
            unsigned char byte = (unsigned char)*c;
            if (*c == '\\') {
                uri[n++] = '/';
            } else if (is_letter(*c) || (*c >= '0' && *c <= '9') || strchr(plain, *c)) {
                uri[n++] = *c;
            } else {
                uri[n++] = '%';
                uri[n++] = digits[byte / 16];
                uri[n++] = digits[byte % 16];
            }
        }
    }
    uri[n] = 0;
    return uri;
}
