/* fuzz_mesh.c - mesh readers of examples/support: the first byte picks the format, the rest is the file */
#include "../../examples/support/mesh.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
/* The materials of an OBJ: the file itself, so that the fuzzer reaches that reader too. */
static int open_itself(void *user, const char *name, char **data, size_t *size) {
    const sup_text *text = (const sup_text *)user;
    (void)name;
    *size = (size_t)(text->end - text->begin);
    *data = (char *)malloc(*size + 1);
    if (*data) memcpy(*data, text->begin, *size);
    return *data == NULL;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    sup_text text;
    sup_mesh mesh;
    sup_error err;
    float lo[3], hi[3];
    if (size == 0) return 0;
    text.begin = text.at = (const char *)data + 1;
    text.end = (const char *)data + size;
    if (!sup_mesh_read_memory(text.begin, size - 1, (sup_format)(data[0] % 5), "x.off", open_itself, &text, &mesh,
                              &err)) {
        if (sup_mesh_compute_normals(&mesh, &err)) abort(); /* the readers have checked every index */
        (void)sup_mesh_bounds(&mesh, lo, hi);
    }
    sup_mesh_free(&mesh);
    return 0;
}
