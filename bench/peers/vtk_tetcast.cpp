/* vtk_tetcast.cpp - tetrahedra drawn, contoured and sampled by tetcast and by VTK 9 - MIT OR Unlicense, see LICENSE

   peer_vtk_tetcast [--full] [--threads N]      needs a screen: xvfb-run -a build/peer_vtk_tetcast

   Both get the same vertices, values, camera and transfer function, 512 x 512 pixels. The camera turns a little from frame to
   frame, as VTK keeps what depends on the view. Each opacity knot is a colour knot, too: VTK 9.1 interpolates opacity between
   colour knots only. What is right is an integrator in double precision that splits at every knot (tests/ray_oracle.h) at
   every eighth pixel of every eighth row. Rays of VTK's ray casters go through corners of pixels, so they are compared with
   what is seen there. VTK's picture has eight bits, which alone is an error of 1/510. */
#include "../bench.h"
#include "../../tests/test.h"
#include "../../examples/support/volume.h"
#include "../../examples/support/volume_scenes.h"
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"
#include "peer.h"
#include "../../tests/ray_oracle.h"
#include "../../tests/foam_oracle.h"
#include "../bench_tets.h"
#include <vtkCamera.h>
#include <vtkCellArray.h>
#include <vtkCellType.h>
#include <vtkColorTransferFunction.h>
#include <vtkContour3DLinearGrid.h>
#include <vtkContourFilter.h>
#include <vtkContourGrid.h>
#include <vtkFloatArray.h>
#include <vtkIdTypeArray.h>
#include <vtkImageData.h>
#include <vtkNew.h>
#include <vtkPiecewiseFunction.h>
#include <vtkPointData.h>
#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkProbeFilter.h>
#include <vtkProjectedTetrahedraMapper.h>
#include <vtkRenderWindow.h>
#include <vtkRenderer.h>
#include <vtkResampleToImage.h>
#include <vtkSMPTools.h>
#include <vtkSmartPointer.h>
#include <vtkUnsignedCharArray.h>
#include <vtkUnstructuredGrid.h>
#include <vtkUnstructuredGridHomogeneousRayIntegrator.h>
#include <vtkUnstructuredGridLinearRayIntegrator.h>
#include <vtkUnstructuredGridPartialPreIntegration.h>
#include <vtkUnstructuredGridVolumeRayCastMapper.h>
#include <vtkUnstructuredGridVolumeZSweepMapper.h>
#include <vtkVersion.h>
#include <vtkVolume.h>
#include <vtkVolumeProperty.h>
#include <vtkAutoInit.h>
VTK_MODULE_INIT(vtkRenderingOpenGL2)
VTK_MODULE_INIT(vtkRenderingVolumeOpenGL2)

enum { SIZE = 512, ROUNDS = 5, EVERY = 8 };
static const char *const g_isa = tetcast_isa_name(tetcast_isa_best());
static const char *const g_colour = "largest error of a colour, 0 to 1";
static std::string g_vtk;

/* ---- the same things for VTK ---- */

static vtkSmartPointer<vtkUnstructuredGrid> make_grid(const tets *t) {
    auto grid = vtkSmartPointer<vtkUnstructuredGrid>::New();
    vtkNew<vtkPoints> points;
    vtkNew<vtkFloatArray> values;
    vtkNew<vtkCellArray> cells;
    vtkNew<vtkIdTypeArray> offsets, corners;
    points->SetDataTypeToFloat();
    points->SetNumberOfPoints((vtkIdType)t->nv);
    values->SetName("s");
    values->SetNumberOfValues((vtkIdType)t->nv);
    for (size_t i = 0; i < t->nv; i++) {
        points->SetPoint((vtkIdType)i, t->p[3 * i], t->p[3 * i + 1], t->p[3 * i + 2]);
        values->SetValue((vtkIdType)i, t->s[i]);
    }
    offsets->SetNumberOfValues((vtkIdType)t->nt + 1);
    corners->SetNumberOfValues((vtkIdType)(4 * t->nt));
    for (size_t i = 0; i <= t->nt; i++) offsets->SetValue((vtkIdType)i, (vtkIdType)(4 * i));
    for (size_t i = 0; i < 4 * t->nt; i++) corners->SetValue((vtkIdType)i, (vtkIdType)t->t[i]);
    cells->SetData(offsets, corners);
    grid->SetPoints(points);
    grid->SetCells(VTK_TETRA, cells);
    grid->GetPointData()->SetScalars(values);
    return grid;
}

static const double UNIT = 0.2; /* of length: what projected tetrahedra have in bytes stays below 1 */
enum { WITH_DEFAULT, WITH_HOMOGENEOUS, WITH_LINEAR, WITH_PARTIAL, WITH_ZSWEEP, WITH_PROJECTED };
static const char *const g_with[6] = {"ray cast, pre-integrated", "ray cast, homogeneous", "ray cast, linear", "ray cast, partially pre-integrated",
                                      "ZSweep", "projected tetrahedra"};

/* A window with one volume in it. */
struct vtk_view {
    vtkNew<vtkRenderer> renderer;
    vtkNew<vtkRenderWindow> window;
    vtkSmartPointer<vtkUnstructuredGridVolumeMapper> mapper;
    std::string name;

    vtk_view(vtkUnstructuredGrid *grid, int with) : name(g_vtk + " " + g_with[with]) {
        vtkNew<vtkColorTransferFunction> colour;
        vtkNew<vtkPiecewiseFunction> opacity;
        vtkNew<vtkVolumeProperty> property;
        vtkNew<vtkVolume> volume;
        size_t n;
        const tetcast_control_point *p = tf_points(TF_SMOOTH, &n);
        for (size_t i = 0; i < n; i++) {
            colour->AddRGBPoint((double)p[i].value, (double)p[i].rgb[0], (double)p[i].rgb[1], (double)p[i].rgb[2]);
            opacity->AddPoint((double)p[i].value, UNIT * (double)p[i].extinction);
        }
        property->SetColor(colour);
        property->SetScalarOpacity(opacity);
        property->SetScalarOpacityUnitDistance(UNIT);
        property->ShadeOff();
        property->SetInterpolationTypeToLinear();
        if (with == WITH_PROJECTED) {
            mapper = vtkSmartPointer<vtkProjectedTetrahedraMapper>::New();
        } else if (with == WITH_ZSWEEP) {
            auto z = vtkSmartPointer<vtkUnstructuredGridVolumeZSweepMapper>::New();
            z->SetAutoAdjustSampleDistances(0);
            z->SetImageSampleDistance(1);
            z->SetIntermixIntersectingGeometry(0);
            mapper = z;
        } else {
            auto r = vtkSmartPointer<vtkUnstructuredGridVolumeRayCastMapper>::New();
            r->SetAutoAdjustSampleDistances(0);
            r->SetImageSampleDistance(1);
            r->SetIntermixIntersectingGeometry(0);
            r->SetNumberOfThreads(g_peer_threads);
            if (with == WITH_HOMOGENEOUS) r->SetRayIntegrator(vtkSmartPointer<vtkUnstructuredGridHomogeneousRayIntegrator>::New());
            if (with == WITH_LINEAR) r->SetRayIntegrator(vtkSmartPointer<vtkUnstructuredGridLinearRayIntegrator>::New());
            if (with == WITH_PARTIAL) r->SetRayIntegrator(vtkSmartPointer<vtkUnstructuredGridPartialPreIntegration>::New());
            mapper = r;
        }
        mapper->SetInputData(grid);
        volume->SetMapper(mapper);
        volume->SetProperty(property);
        renderer->SetBackground(0, 0, 0);
        renderer->AddVolume(volume);
        window->SetMultiSamples(0);
        window->SetOffScreenRendering(1);
        window->SetSize(SIZE, SIZE);
        window->AddRenderer(renderer);
    }
    void draw(const tetcast_camera &c) {
        vtkCamera *to = renderer->GetActiveCamera();
        to->SetFocalPoint(c.at[0], c.at[1], c.at[2]);
        to->SetPosition(c.eye[0], c.eye[1], c.eye[2]);
        to->SetViewUp(0, 1, 0);
        to->SetViewAngle((double)c.fov_y);
        renderer->ResetCameraClippingRange(0, 1, 0, 1, 0, 1);
        window->Render();
    }
    std::vector<float> pixels(void) { /* row 0 on top, rgb */
        vtkNew<vtkUnsignedCharArray> bytes;
        std::vector<float> out(3 * SIZE * SIZE);
        window->GetRGBACharPixelData(0, 0, SIZE - 1, SIZE - 1, 0, bytes);
        for (size_t y = 0; y < SIZE; y++)
            for (size_t x = 0; x < SIZE; x++)
                for (size_t a = 0; a < 3; a++)
                    out[3 * (y * SIZE + x) + a] = (float)bytes->GetValue((vtkIdType)(4 * ((SIZE - 1 - y) * SIZE + x) + a)) / 255.0f;
        return out;
    }
};

/* ---- pictures ---- */

static tetcast_camera turned(int step) { /* the peers' camera on its way around the cube */
    tetcast_camera c;
    const double a = 0.02 * step;
    memset(&c, 0, sizeof c);
    for (int k = 0; k < 3; k++) c.at[k] = 0.5;
    c.eye[0] = 0.5 + 1.1 * cos(a) + 1.5 * sin(a);
    c.eye[1] = 1.3;
    c.eye[2] = 0.5 + 1.5 * cos(a) - 1.1 * sin(a);
    c.fov_y = 40.0f;
    return c;
}

struct right_picture { std::vector<double> rgb; };

/* Through points that lie (x, y) beside the centres of pixels. */
static right_picture exact_picture(const tetcast_mesh *mesh, const tets *t, double dx, double dy) {
    const tetcast_camera c = turned(0);
    right_picture r;
    size_t n;
    const tetcast_control_point *p = tf_points(TF_SMOOTH, &n);
    oracle_cells list;
    memset(&list, 0, sizeof list);
    for (uint32_t y = EVERY / 2; y < SIZE; y += EVERY)
        for (uint32_t x = EVERY / 2; x < SIZE; x += EVERY) {
            tetcast_ray ray;
            double rgba[4];
            must(tetcast_camera_ray(&c, SIZE, SIZE, x + 0.5 + dx, y + 0.5 + dy, &ray), "camera");
            oracle_ray(mesh, t, p, n, 0, &ray, &list, rgba);
            r.rgb.insert(r.rgb.end(), rgba, rgba + 3);
        }
    free(list.visit);
    return r;
}

struct picture_error { double most, psnr; size_t off; };

static picture_error judge(const right_picture &right, const float *rgb, size_t stride) {
    picture_error e = {0, 0, 0};
    double sum = 0;
    size_t n = 0;
    for (size_t y = EVERY / 2; y < SIZE; y += EVERY)
        for (size_t x = EVERY / 2; x < SIZE; x += EVERY, n++) {
            double worst = 0;
            for (size_t a = 0; a < 3; a++) {
                const double d = fabs((double)rgb[stride * (y * SIZE + x) + a] - right.rgb[3 * n + a]);
                worst = std::max(worst, d);
                sum += d * d;
            }
            e.most = std::max(e.most, worst);
            e.off += worst > 1.5 / 255.0;
        }
    e.psnr = -10.0 * log10(sum / (3.0 * (double)n) + 1e-30);
    return e;
}

static void put_bytes(peer_side *p, double bytes, size_t cells) {
    p->bytes = bytes;
    p->bytes_each = bytes / (double)cells;
}

static void frames(const char *id, const char *kase, int mesh_id, const std::vector<int> &withs) {
    const tets *t = get_tets(mesh_id);
    const tetcast_mesh *mesh = get_mesh(mesh_id);
    const auto grid = make_grid(t);
    const right_picture centre = exact_picture(mesh, t, 0, 0), corner = exact_picture(mesh, t, -0.5, 0.5);
    tetcast_optics *optics = make_optics(TF_SMOOTH, nullptr);
    tetcast_render_desc d;
    tetcast_render_stats stats;
    tetcast_image image;
    tetcast_mesh_info info;
    std::vector<float> rgba(4 * SIZE * SIZE);
    std::vector<vtk_view *> view;
    std::vector<peer_side> p = {peer_ours("tetcast_render, exact", g_isa)};
    std::vector<int> step(withs.size() + 1, 0);
    const double grid_bytes = 1024.0 * (double)grid->GetActualMemorySize();
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    d.env.thread_count = (uint32_t)g_peer_threads;
    image.width = image.height = SIZE;
    image.rgba = rgba.data();
    tetcast_mesh_get_info(mesh, &info);
    put_bytes(&p[0], (double)info.total_bytes, t->nt);
    p[0].run = [&] {
        d.camera = turned(step[0]++);
        must(tetcast_render(&d, mesh, optics, &image, nullptr), "render");
    };
    for (size_t i = 0; i < withs.size(); i++) {
        const double before = peer_heap();
        view.push_back(new vtk_view(grid, withs[i]));
        view[i]->draw(turned(-1)); /* it builds what it needs */
        p.push_back(peer_theirs(view[i]->name.c_str(), g_with[withs[i]]));
        put_bytes(&p[i + 1], grid_bytes + std::max(0.0, peer_heap() - before), t->nt);
        p[i + 1].run = [&, i] { view[i]->draw(turned(step[i + 1]++)); };
    }
    p[0].run();
    peer_time(p.data(), (int)p.size(), ROUNDS, false);
    d.camera = turned(0);
    memset(&stats, 0, sizeof stats);
    must(tetcast_render(&d, mesh, optics, &image, &stats), "render");
    std::vector<peer_side> psnr, off;
    for (size_t i = 0; i < p.size(); i++) {
        if (i > 0) view[i - 1]->draw(turned(0));
        const picture_error e = i == 0 ? judge(centre, rgba.data(), 4) :
            judge(withs[i - 1] == WITH_PROJECTED ? centre : corner, view[i - 1]->pixels().data(), 3);
        p[i].error = e.most;
        peer_side s = p[i];
        s.run = nullptr;
        s.seconds.clear();
        s.value = e.psnr;
        psnr.push_back(s);
        s.value = (double)e.off;
        off.push_back(s);
    }
    p[0].hash = bench_hash_bytes(rgba.data(), 16 * SIZE * SIZE);
    p[0].isa = psnr[0].isa = off[0].isa = tetcast_isa_name(stats.isa);
    peer_lines(id, kase, "frame_seconds", "s", 0, g_colour, p.data(), (int)p.size());
    const std::string more = kase;
    if (mesh_id == MESH_K32 && g_peer_threads == 1) {
        peer_lines("T11", (more + ": PSNR").c_str(), "psnr", "dB", 0, g_colour, psnr.data(), (int)psnr.size());
        peer_lines("T11", (more + ": pixels off by more than 1.5/255, of 4,096").c_str(), "pixels", "pixels", 0, g_colour, off.data(), (int)off.size());
    }
    for (vtk_view *v : view) delete v;
    tetcast_optics_destroy(optics);
}

/* What an empty part of the transfer function is worth: against a function that has next to nothing there. */
static void empty_space(const char *kase, int mesh_id) {
    const right_picture right = exact_picture(get_mesh(mesh_id), get_tets(mesh_id), 0, 0);
    const tetcast_mesh *mesh = get_mesh(mesh_id);
    tetcast_optics *optics[2] = {make_optics(TF_SMOOTH, nullptr), make_optics(TF_FULL, nullptr)};
    tetcast_render_desc d;
    tetcast_render_stats stats;
    tetcast_image image;
    std::vector<float> rgba(4 * SIZE * SIZE);
    peer_side p[2] = {peer_ours("tetcast_render", g_isa), peer_ours("tetcast_render", g_isa)};
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    d.env.thread_count = (uint32_t)g_peer_threads;
    d.camera = turned(0);
    image.width = image.height = SIZE;
    image.rgba = rgba.data();
    for (int i = 0; i < 2; i++)
        p[i].run = [&, i] { must(tetcast_render(&d, mesh, optics[i], &image, &stats), "render"); };
    memset(&stats, 0, sizeof stats);
    peer_time(p, 2, ROUNDS);
    p[0].run();
    p[0].isa = tetcast_isa_name(stats.isa);
    p[0].error = judge(right, rgba.data(), 4).most;
    p[0].value = peer_median(p[1].seconds) / peer_median(p[0].seconds);
    p[0].seconds.clear();
    peer_lines("T4", kase, "times_as_fast", "times", 0, g_colour, p, 1);
    for (tetcast_optics *o : optics) tetcast_optics_destroy(o);
}

/* ---- building ---- */

static size_t g_held, g_peak;
static void *counted_alloc(size_t size, void *) {
    void *p = malloc(size);
    if (p != nullptr) {
        g_held += size;
        g_peak = std::max(g_peak, g_held);
    }
    return p;
}
static void counted_free(void *p, size_t size, void *) {
    if (p != nullptr) g_held -= size;
    free(p);
}

static void build(const char *kase, const char *size, int mesh_id) {
    const tets *t = get_tets(mesh_id);
    const auto grid = make_grid(t);
    tetcast_mesh *mesh = nullptr;
    tetcast_mesh_desc d;
    tetcast_mesh_info info;
    peer_side p[2] = {peer_ours("tetcast_mesh_create", g_isa), peer_theirs(g_vtk.c_str(), "first frame less a later one, homogeneous")};
    memset(&d, 0, sizeof d);
    d.env.thread_count = (uint32_t)g_peer_threads;
    p[0].run = [&] {
        tetcast_mesh_destroy(mesh);
        mesh = build_mesh(t, &d);
    };
    p[0].run();
    for (int k = 0; k < ROUNDS; k++) { /* VTK builds with the first frame */
        peer_time(p, 1, 1, false);
        vtk_view view(grid, WITH_HOMOGENEOUS);
        const double before = peer_heap(), first = peer_once([&] { view.draw(turned(0)); });
        const double again = peer_once([&] { view.draw(turned(1)); });
        p[1].seconds.push_back(first - again);
        if (k == 0) put_bytes(&p[1], 1024.0 * (double)grid->GetActualMemorySize() + std::max(0.0, peer_heap() - before), t->nt);
    }
    tetcast_mesh_get_info(mesh, &info);
    p[0].error = (double)(t->nt - info.cell_count);
    p[1].error = (double)t->nt - (double)grid->GetNumberOfCells();
    put_bytes(&p[0], (double)info.total_bytes, t->nt);
    peer_lines("T6", kase, "build_seconds", "s", 0, "cells lost", p, 2);
    for (peer_side &s : p) {
        s.seconds.clear();
        s.value = s.bytes_each;
    }
    p[0].method = "default mesh";
    p[1].method = "grid and mapper";
    peer_lines("T5", (std::string(size) + ", default").c_str(), "bytes_per_cell", "B", 0, "cells lost", p, 2);
    d.cells = TETCAST_CELLS_TET8;
    d.drop_tets = d.drop_source = d.disable_clusters = 1;
    tetcast_mesh_destroy(mesh);
    mesh = build_mesh(t, &d);
    tetcast_mesh_get_info(mesh, &info);
    put_bytes(&p[0], (double)info.total_bytes, t->nt);
    p[0].value = p[0].bytes_each;
    p[0].method = "Tet8, what rays need";
    peer_lines("T5", (std::string(size) + ", what rays need").c_str(), "bytes_per_cell", "B", 0, "cells lost", p, 2);
    d.cells = TETCAST_CELLS_STRIPS;
    tetcast_mesh_destroy(mesh);
    mesh = build_mesh(t, &d);
    tetcast_mesh_get_info(mesh, &info);
    p[0].error = (double)(t->nt - info.cell_count);
    put_bytes(&p[0], (double)info.total_bytes, t->nt);
    p[0].value = p[0].bytes_each;
    p[0].method = "strips, what rays need";
    peer_lines("T5", (std::string(size) + ", strips").c_str(), "bytes_per_cell", "B", 0, "cells lost", p, 2);
    d.cells = TETCAST_CELLS_TET8;
    const double theirs = p[1].bytes_each;
    tetcast_mesh_destroy(mesh);
    if (g_peer_threads > 1) return;
    tets big;
    memset(&big, 0, sizeof big);
    make_kuhn(&big, 119);
    d.env.allocator.alloc_fn = counted_alloc;
    d.env.allocator.free_fn = counted_free;
    g_held = g_peak = 0;
    mesh = build_mesh(&big, &d);
    tetcast_mesh_get_info(mesh, &info);
    put_bytes(&p[0], (double)info.total_bytes, big.nt);
    p[0].value = (double)g_peak;
    p[0].method = "tetcast_mesh_create, most at once";
    p[0].error = (double)(big.nt - info.cell_count);
    p[1].bytes_each = theirs;
    p[1].bytes = p[1].value = theirs * (double)big.nt;
    p[1].error = NAN;
    p[1].method = "grid and mapper, from 10^6 cells";
    peer_lines("T10", "10,110,954 tetrahedra, lean", "bytes", "B", 0, "cells lost", p, 2);
    tetcast_mesh_destroy(mesh);
    tets_free(&big);
}

/* ---- isosurfaces ---- */

/* Area of the surface at 0.5, in double precision. */
static double exact_area(const tets *t) {
    double sum = 0;
    for (size_t i = 0; i < t->nt; i++) {
        const uint32_t *v = t->t + 4 * i;
        double q[4][3];
        int n = 0, in[4], out[4], ni = 0, no = 0;
        for (int k = 0; k < 4; k++) {
            if (t->s[v[k]] >= 0.5f) in[ni++] = k;
            else out[no++] = k;
        }
        for (int a = 0; a < ni; a++)
            for (int b = 0; b < no; b++, n++) {
                if (ni == 0 || no == 0) continue;
                const double s = (double)t->s[v[in[a]]], u = (double)t->s[v[out[b]]], w = (0.5 - s) / (u - s);
                for (int c = 0; c < 3; c++) q[n][c] = t->p[3 * v[in[a]] + (size_t)c] * (1 - w) + t->p[3 * v[out[b]] + (size_t)c] * w;
            }
        for (int k = 0; k + 2 < n; k++) { /* four: 0 1 3 2 is the way around, so 0 1 2 and 1 2 3 are its halves */
            double e[2][3], x[3];
            for (int c = 0; c < 3; c++) {
                e[0][c] = q[k + 1][c] - q[k][c];
                e[1][c] = q[k + 2][c] - q[k][c];
            }
            for (int c = 0; c < 3; c++) x[c] = e[0][(c + 1) % 3] * e[1][(c + 2) % 3] - e[0][(c + 2) % 3] * e[1][(c + 1) % 3];
            sum += 0.5 * sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
        }
    }
    return sum;
}

static double triangle_area(const double *a, const double *b, const double *c) {
    double x[3];
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        x[k] = (b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i]);
    }
    return 0.5 * sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
}

static double vtk_area(vtkPolyData *d) {
    vtkNew<vtkIdList> ids;
    double sum = 0;
    vtkCellArray *cells = d->GetPolys();
    for (vtkIdType i = 0; i < cells->GetNumberOfCells(); i++) {
        double p[3][3];
        cells->GetCellAtId(i, ids);
        for (vtkIdType k = 0; k < 3; k++) d->GetPoint(ids->GetId(k), p[k]);
        sum += triangle_area(p[0], p[1], p[2]);
    }
    return sum;
}

static void contour(const char *kase, int mesh_id) {
    const tets *t = get_tets(mesh_id);
    const tetcast_mesh *mesh = get_mesh(mesh_id);
    const auto grid = make_grid(t);
    const double area = exact_area(t);
    tetcast_surface_desc d;
    tetcast_surface surface;
    vtkSmartPointer<vtkPolyData> made[3];
    peer_side p[4] = {peer_ours("tetcast_isosurface", g_isa), peer_theirs(g_vtk.c_str(), "vtkContour3DLinearGrid, merged"),
                      peer_theirs(g_vtk.c_str(), "vtkContourFilter"), peer_theirs(g_vtk.c_str(), "vtkContourGrid")};
    memset(&d, 0, sizeof d);
    memset(&surface, 0, sizeof surface);
    d.env.thread_count = (uint32_t)g_peer_threads;
    d.isovalue = 0.5f;
    p[0].run = [&] {
        tetcast_surface_free(&surface);
        must(tetcast_isosurface(&d, mesh, &surface), "isosurface");
    };
    p[1].run = [&] {
        vtkNew<vtkContour3DLinearGrid> f;
        f->SetInputData(grid);
        f->SetValue(0, 0.5);
        f->MergePointsOn();
        f->Update();
        made[0] = vtkPolyData::SafeDownCast(f->GetOutputDataObject(0));
    };
    p[2].run = [&] {
        vtkNew<vtkContourFilter> f;
        f->SetInputData(grid);
        f->SetValue(0, 0.5);
        f->ComputeNormalsOff();
        f->Update();
        made[1] = f->GetOutput();
    };
    p[3].run = [&] {
        vtkNew<vtkContourGrid> f;
        f->SetInputData(grid);
        f->SetValue(0, 0.5);
        f->ComputeNormalsOff();
        f->Update();
        made[2] = f->GetOutput();
    };
    peer_time(p, 4, ROUNDS);
    double sum = 0;
    for (uint32_t i = 0; i < surface.triangle_count; i++) {
        double q[3][3];
        for (int k = 0; k < 3; k++)
            for (int c = 0; c < 3; c++) q[k][c] = (double)surface.positions[3 * (size_t)surface.indices[3 * (size_t)i + (size_t)k] + (size_t)c];
        sum += triangle_area(q[0], q[1], q[2]);
    }
    p[0].error = fabs(sum - area) / area;
    put_bytes(&p[0], 12.0 * (double)surface.vertex_count + 12.0 * (double)surface.triangle_count, surface.triangle_count);
    for (int i = 0; i < 3; i++) {
        p[i + 1].error = fabs(vtk_area(made[i]) - area) / area;
        put_bytes(&p[i + 1], 1024.0 * (double)made[i]->GetActualMemorySize(), (size_t)made[i]->GetNumberOfCells());
    }
    peer_lines("T8", kase, "cells_per_second", "1/s", (double)t->nt, "of the area in double precision", p, 4);
    tetcast_surface_free(&surface);
}

static void first_hit(const char *kase, int mesh_id) { /* VTK has no ray cast of isosurfaces in tetrahedra */
    const tetcast_mesh *mesh = get_mesh(mesh_id);
    const tets *t = get_tets(mesh_id);
    tetcast_optics_desc od;
    tetcast_isovalue iso;
    tetcast_render_desc d;
    tetcast_image image;
    std::vector<float> rgba(4 * SIZE * SIZE);
    peer_side p[1] = {peer_ours("tetcast_render, isosurface", g_isa)};
    tetcast_render_stats stats;
    oracle_cells list;
    double most = 0;
    memset(&od, 0, sizeof od);
    memset(&stats, 0, sizeof stats);
    memset(&iso, 0, sizeof iso);
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    memset(&list, 0, sizeof list);
    od.model = TETCAST_MODEL_ISOSURFACE;
    iso.value = 0.5f;
    iso.rgb[0] = 1;
    iso.opacity = 1;
    tetcast_optics *o = make_optics_range(TF_SMOOTH, 0, 1, 1, &od, &iso, 1);
    d.env.thread_count = (uint32_t)g_peer_threads;
    d.camera = turned(0);
    image.width = image.height = SIZE;
    image.rgba = rgba.data();
    p[0].run = [&] { must(tetcast_render(&d, mesh, o, &image, &stats), "render"); };
    peer_time(p, 1, ROUNDS);
    p[0].isa = tetcast_isa_name(stats.isa);
    for (uint32_t y = 4; y < SIZE; y += 8)
        for (uint32_t x = 4; x < SIZE; x += 8) {
            tetcast_ray ray;
            tetcast_ray_result got;
            must(tetcast_camera_ray(&d.camera, SIZE, SIZE, x + 0.5, y + 0.5, &ray), "camera");
            must(tetcast_cast(&d, mesh, o, &ray, 1, &got, nullptr), "cast");
            const double want = oracle_hit(mesh, t, 0.5, &ray, &list);
            if (want < 1e30 && got.hit < 1e30f) most = std::max(most, fabs((double)got.hit - want));
            else if (want < 1e30 || got.hit < 1e30f) most = std::max(most, 1.0);
        }
    free(list.visit);
    p[0].error = most;
    peer_lines("T7", kase, "rays_per_second", "1/s", SIZE * SIZE, "largest error of a distance, edge of the cube", p, 1);
    tetcast_optics_destroy(o);
}

/* ---- cells of constant colour around points: VTK has none ---- */

static void foam(const char *kase, int mesh_id) {
    const tets *t = get_tets(mesh_id);
    tetcast_site *sites = tet_sites(t);
    tetcast_foam_desc fd;
    tetcast_foam *f = nullptr;
    tetcast_foam_info info;
    tetcast_render_desc d;
    tetcast_render_stats stats;
    tetcast_image image;
    std::vector<float> rgba(4 * SIZE * SIZE);
    peer_side p[1] = {peer_ours("tetcast_foam_render", g_isa)};
    memset(&fd, 0, sizeof fd);
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    must(tetcast_foam_create(&fd, sites, t->nv, &f), "foam");
    tetcast_foam_get_info(f, &info);
    d.env.thread_count = (uint32_t)g_peer_threads;
    d.camera = turned(0);
    image.width = image.height = SIZE;
    image.rgba = rgba.data();
    p[0].run = [&] {
        memset(&stats, 0, sizeof stats);
        must(tetcast_foam_render(&d, f, &image, &stats), "render");
    };
    peer_time(p, 1, ROUNDS);
    p[0].isa = tetcast_isa_name(stats.isa);
    p[0].error = foam_error(f, sites, t->nv, &d.camera, rgba.data(), SIZE, 128);
    put_bytes(&p[0], (double)info.bytes, info.cell_count);
    peer_lines("T12", kase, "cells_per_second", "1/s", (double)stats.steps, "largest difference of a colour from a march through all points", p, 1);
    tetcast_foam_destroy(f);
    free(sites);
}

/* ---- samples on a grid ---- */

static void resample(const char *kase, int mesh_id, int n) {
    const tets *t = get_tets(mesh_id);
    const tetcast_mesh *mesh = get_mesh(mesh_id);
    const auto grid = make_grid(t);
    tetcast_lattice lattice;
    tetcast_resample_desc d;
    peer_side p[3] = {peer_ours("tetcast_resample", g_isa), peer_theirs(g_vtk.c_str(), "vtkResampleToImage"), peer_theirs(g_vtk.c_str(), "vtkProbeFilter")};
    const size_t all = (size_t)n * (size_t)n * (size_t)n;
    std::vector<float> values(all);
    vtkSmartPointer<vtkImageData> image[2];
    vtkSmartPointer<vtkDataSet> probed;
    memset(&d, 0, sizeof d);
    memset(&lattice, 0, sizeof lattice);
    d.env.thread_count = (uint32_t)g_peer_threads;
    for (int a = 0; a < 3; a++) {
        lattice.dims[a] = (uint32_t)n;
        lattice.spacing[a] = 1.0 / (n - 1);
    }
    p[0].run = [&] { must(tetcast_resample(&d, mesh, &lattice, values.data(), nullptr), "resample"); };
    p[1].run = [&] {
        vtkNew<vtkResampleToImage> f;
        f->SetInputDataObject(grid);
        f->SetSamplingDimensions(n, n, n);
        f->Update();
        image[0] = f->GetOutput();
    };
    p[2].run = [&] {
        vtkNew<vtkProbeFilter> f;
        vtkNew<vtkImageData> at;
        at->SetDimensions(n, n, n);
        at->SetSpacing(1.0 / (n - 1), 1.0 / (n - 1), 1.0 / (n - 1));
        f->SetInputData(at);
        f->SetSourceData(grid);
        f->Update();
        probed = f->GetOutput();
    };
    p[0].run();
    peer_time(p, 3, ROUNDS, false);
    for (int i = 0; i < 3; i++) {
        vtkPointData *data = i == 0 ? nullptr : i == 1 ? image[0]->GetPointData() : probed->GetPointData();
        vtkDataArray *s = data != nullptr ? data->GetArray("s") : nullptr, *valid = data != nullptr ? data->GetArray("vtkValidPointMask") : nullptr;
        double sum = 0;
        for (size_t k = 0; k < all; k++) {
            const size_t m = (size_t)n;
            const double q[3] = {(double)(k % m) / (n - 1), (double)(k / m % m) / (n - 1), (double)(k / m / m) / (n - 1)};
            const int missing = i == 0 ? values[k] != values[k] : valid != nullptr && valid->GetTuple1((vtkIdType)k) == 0;
            sum += missing ? 1.0 : fabs((i == 0 ? (double)values[k] : s->GetTuple1((vtkIdType)k)) - (double)field(q));
        }
        p[i].error = sum / (double)all;
        put_bytes(&p[i], i == 0 ? 4.0 * (double)all : 1024.0 * (double)(i == 1 ? image[0]->GetActualMemorySize() : probed->GetActualMemorySize()), all);
    }
    peer_lines("T9", kase, "samples_per_second", "1/s", (double)all, "mean difference from the field itself, 1 where there is no value", p, 3);
}

int main(int argc, char **argv) {
    const int status = peer_parse(argc, argv, &g_opt);
    if (status) return status;
    peer_machine("vtk_tetcast", argv[0], "tetcast.h", tetcast_version());
    g_vtk = std::string("VTK ") + vtkVersion::GetVTKVersion();
    vtkSMPTools::Initialize(g_peer_threads);
    make_delaunay(&g_slots[MESH_D31K].t, 31000); /* the file of this name is another of the kind */
    const bool screen = getenv("DISPLAY") != nullptr;
    if (screen) {
        {
            vtk_view first(make_grid(get_tets(MESH_K32)), WITH_HOMOGENEOUS); /* what all windows share is made here */
            first.draw(turned(0));
        }
        frames("T1", "frame, K32 (196,608 tetrahedra)", MESH_K32,
               g_opt.full ? std::vector<int>{WITH_DEFAULT, WITH_HOMOGENEOUS, WITH_LINEAR, WITH_PARTIAL, WITH_PROJECTED, WITH_ZSWEEP} :
               std::vector<int>{WITH_DEFAULT, WITH_HOMOGENEOUS, WITH_LINEAR, WITH_PROJECTED});
        frames("T2", "frame, D31k (207,000, Delaunay)", MESH_D31K, {WITH_DEFAULT, WITH_PROJECTED});
        if (g_peer_threads == 1 || g_opt.full) frames("T3", "frame, D150k (10^6, Delaunay)", MESH_D150K, {WITH_DEFAULT, WITH_PROJECTED});
        if (g_peer_threads == 1 || g_opt.full) build("build, D150k (10^6, Delaunay)", "memory, D150k (10^6, Delaunay)", MESH_D150K);
    } else {
        bench_skip("peers.vtk_tetcast", "pictures", "VTK has no screen: neither DISPLAY nor xvfb-run (Debian: xvfb xauth)");
    }
    empty_space("transfer function empty on 40 %, K32", MESH_K32);
    empty_space("transfer function empty on 40 %, D31k", MESH_D31K);
    first_hit("first isosurface hit, K32", MESH_K32);
    first_hit("first isosurface hit, D31k", MESH_D31K);
    foam("Voronoi cells, points of D150k", MESH_D150K);
    contour("isosurface, vertices merged, K55 (998,250)", MESH_K55);
    if (g_peer_threads == 1 || g_opt.full) contour("isosurface, vertices merged, D150k (10^6, Delaunay)", MESH_D150K);
    if (g_peer_threads == 1 || g_opt.full) resample("K32 to 128^3", MESH_K32, 128);
    for (int i = 0; i < MESH_COUNT; i++) drop_mesh(i);
    return 0;
}
