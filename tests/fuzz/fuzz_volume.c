/* fuzz_volume.c - volume readers of examples/support: the first byte picks the format, the rest is the file */
#include "../../examples/support/transfer.h"
#include "../../examples/support/volume.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
/* The second file (.ele, Q): the file itself, so that the fuzzer reaches that reader too. */
static int open_itself(void *user, const char *name, char **data, size_t *size) {
    const sup_text *text = (const sup_text *)user;
    (void)name;
    *size = (size_t)(text->end - text->begin);
    *data = (char *)malloc(*size + 1);
    if (*data) memcpy(*data, text->begin, *size);
    return *data == NULL;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const char *const names[6] = {"x.vtk", "x.inp", "x.node", "x.ele", "xyz.bin", "x.msh"};
    sup_text text;
    sup_volume volume;
    sup_transfer transfer;
    sup_error err;
    size_t i;
    if (size == 0) return 0;
    text.begin = text.at = (const char *)data + 1;
    text.end = (const char *)data + size;
    if (!sup_volume_read_memory(text.begin, size - 1, names[data[0] % 6], open_itself, &text, &volume, &err)) {
        for (i = 0; i < volume.index_count; i++)
            if (volume.indices[i] >= volume.point_count) abort(); /* the readers have checked every index */
        if (volume.dims[0] && (uint64_t)volume.dims[0] * volume.dims[1] * volume.dims[2] != volume.point_count) abort();
        for (i = 0; i < volume.field_count && !volume.dims[0]; i++) /* and have a value for everything */
            if (volume.fields[i].count < (volume.fields[i].per_cell ? volume.cell_count : volume.point_count)) abort();
    }
    sup_volume_free(&volume);
    if (!sup_transfer_read_memory(text.begin, size - 1, "tf", &transfer, &err)) sup_transfer_free(&transfer);
    return 0;
}
