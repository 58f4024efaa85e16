/* page.js - the page: which view is wanted, what is shown. worker.js draws.
   SPDX-License-Identifier: MIT OR Unlicense

   The worker has one request at a time. While the view moves each answer asks for the newest view; when it rests, for
   one more sample of the reference, until there are enough. ?threads=1 in the address: no threads. */
'use strict';
(function () {
    const $ = id => document.getElementById(id);
    const demos = [
        { home: { yaw: 0.55, pitch: 0.35, distance: 3 }, at: [0, -0.02, 0], near: 1.25, far: 12, low: -1.45, whole: true, samples: 32,
          knob: 'Voxels may look as wide as', values: [0, 0.5, 1, 2, 4, 8], start: 2, text: v => v ? v + ' px' : 'any size',
          moving: '1 ray a pixel, to cells of the width above', still: '32 rays a pixel, to the voxels' },
        { home: { yaw: 0.07, pitch: 0.34, distance: 42 }, at: [0, 3, 0], near: 9, far: 6000, low: 0.05, samples: 32,
          knob: 'Chance of a flaw', values: [0.001, 0.05, 0.5, 0.9, 0.999], start: 3, text: v => 'up to ' + 100 * v + ' %',
          moving: 'one random sampling of the surfaces', still: 'the mean of 32, each with another point of the pixel' },
        { home: { yaw: 0.6, pitch: 0.62, distance: 74 }, at: [0, 0, 0], near: 24, far: 320, low: -1.45, whole: true, samples: 16,
          knob: 'Colours may be off by', values: [0, 0.25, 1, 4, 16, 64], start: 2, text: v => v ? v + '/255' : 'rounding only',
          moving: '1 ray a pixel, which may end early', still: '16 rays a pixel, each to its end' }
    ];
    const canvas = $('canvas'), context = canvas.getContext('2d'), stage = $('stage');
    let worker = null, ready = false, busy = false, demo = 0, failed = false;
    let wanted = 0, drawn = -1;   // numbers of views
    let samples = 0, step = 2, slow = 0, moved = 0, first = true;
    const state = demos.map(d => ({ yaw: d.home.yaw, pitch: d.home.pitch, distance: d.home.distance, index: d.start, open: false, text: '' }));

    function say(text, part) {
        $('veil').hidden = text === null;
        if (text === null) return;
        $('message').textContent = text;
        if (part === undefined) $('progress').removeAttribute('value');
        else $('progress').value = part;
    }
    function fail(text) {
        failed = true;
        say(text, 0);
        $('veil').classList.add('bad');
        $('progress').hidden = true;
    }

    // ---- what is asked for ----

    function pixels() { // of the full picture: not more than these browsers draw in a moment
        const box = stage.getBoundingClientRect(), most = 480000;
        let scale = Math.min(window.devicePixelRatio || 1, 1.5);
        const n = box.width * box.height * scale * scale;
        if (n > most) scale *= Math.sqrt(most / n);
        return [Math.max(16, Math.round(box.width * scale)), Math.max(16, Math.round(box.height * scale))];
    }
    function eyeAt() {
        const s = state[demo], d = demos[demo], a = d.at, c = Math.cos(s.pitch), box = stage.getBoundingClientRect();
        const far = s.distance * (d.whole ? Math.max(1, box.height / box.width) : 1); // all of it in upright pictures, too
        return [a[0] + far * c * Math.sin(s.yaw), a[1] + far * Math.sin(s.pitch), a[2] + far * c * Math.cos(s.yaw), a[0], a[1], a[2]];
    }
    function ask() {
        if (busy || failed || !ready) return;
        const s = state[demo], d = demos[demo];
        if (!s.open) {
            say('Making the scene');
            busy = true;
            worker.postMessage({ what: 'open', demo });
        } else if (drawn !== wanted) {
            const [width, height] = pixels();
            busy = true;
            samples = 0;
            worker.postMessage({ what: 'quick', demo, view: eyeAt(), width, height, step, tolerance: d.values[s.index], number: wanted });
        } else if (samples < d.samples) {
            const rest = 250 - (performance.now() - moved); // a view that rests, not one between two moves
            if (rest > 0) { setTimeout(ask, rest); return; }
            busy = true;
            worker.postMessage({ what: 'refine', difference: $('difference').checked, number: wanted });
        }
    }
    function change() {
        wanted++;
        moved = performance.now();
        $('error').textContent = $('samples').textContent = '-';
        ask();
    }

    // ---- answers ----

    function show(m) {
        if (canvas.width !== m.width || canvas.height !== m.height) {
            canvas.width = m.width;
            canvas.height = m.height;
        }
        canvas.style.imageRendering = m.step > 2 ? 'pixelated' : 'auto';
        context.putImageData(new ImageData(new Uint8ClampedArray(m.pixels), m.width, m.height), 0, 0);
    }
    function answer(m) {
        if (m.what === 'progress') { say(m.text, m.part); return; }
        if (m.what === 'failed') { fail(m.text); return; }
        busy = false;
        if (m.what === 'ready') {
            ready = true;
            $('machine').textContent = 'WebAssembly ' + (m.simd ? 'with SIMD, ' : 'without SIMD, ') +
                (m.threads > 1 ? m.threads + ' threads.' : 'one thread' + (m.why ? ' (' + m.why + ').' : '.'));
        } else if (m.what === 'open') {
            state[m.demo].open = true;
            state[m.demo].text = m.text;
            if (m.demo === demo) describe();
        } else if (m.what === 'quick' && m.demo === demo) {
            say(null);
            drawn = m.number;
            show(m);
            $('time').textContent = m.ms.toFixed(m.ms < 10 ? 1 : 0) + ' ms';
            $('size').textContent = m.width + ' \u00d7 ' + m.height + ' px';
            // a picture of fewer pixels where frames take long, of more where there is time
            slow = m.ms > 90 ? Math.max(slow, 0) + 1 : m.ms < 22 ? Math.min(slow, 0) - 1 : 0;
            if ((slow >= 1 && step < 6) || (slow <= -3 && step > 1)) { step += slow > 0 ? 1 : -1; slow = 0; if (first) wanted++; }
            else first = false;
        } else if (m.what === 'refine' && m.number === wanted) {
            samples = m.samples;
            show(m);
            $('samples').textContent = samples + ' of ' + demos[demo].samples;
            $('error').textContent = m.error.toFixed(2) + ' of 255';
        }
        canvas.dataset.drawn = drawn; // for the test of the page
        canvas.dataset.samples = samples;
        ask();
    }

    // ---- the panel ----

    function describe() {
        const d = demos[demo], s = state[demo];
        $('scene').textContent = s.text;
        $('knob').textContent = d.knob;
        $('tolerance').max = d.values.length - 1;
        $('tolerance').value = s.index;
        $('value').textContent = d.text(d.values[s.index]);
        $('meaning').textContent = 'Error: root mean square difference, in red, green and blue of all pixels, between the picture shown while the view moves (' +
            d.moving + ') and the reference drawn when it rests (' + d.still + ').';
        canvas.setAttribute('aria-label', 'Picture of the scene of ' + $('tab' + demo).textContent);
    }
    function choose(n) {
        demo = n;
        drawn = -1;
        first = true;
        for (let i = 0; i < demos.length; i++) {
            $('tab' + i).setAttribute('aria-selected', String(i === n));
            $('tab' + i).tabIndex = i === n ? 0 : -1;
        }
        $('panel').setAttribute('aria-labelledby', 'tab' + n);
        $('time').textContent = $('size').textContent = '-';
        if (ready) say(state[n].open ? 'Drawing' : 'Making the scene');
        describe();
        change();
    }
    demos.forEach((d, i) => {
        $('tab' + i).addEventListener('click', () => choose(i));
        $('tab' + i).addEventListener('keydown', e => {
            const to = { ArrowRight: (i + 1) % demos.length, ArrowLeft: (i + demos.length - 1) % demos.length, Home: 0, End: demos.length - 1 }[e.key];
            if (to === undefined) return;
            e.preventDefault();
            $('tab' + to).focus();
            choose(to);
        });
    });
    $('tolerance').addEventListener('input', () => { state[demo].index = Number($('tolerance').value); describe(); change(); });
    $('difference').addEventListener('change', () => { if (samples > 0) change(); });
    $('home').addEventListener('click', () => { Object.assign(state[demo], demos[demo].home); change(); });

    // ---- turning ----

    function turn(dx, dy) {
        const s = state[demo];
        s.yaw -= dx;
        s.pitch = Math.min(1.5, Math.max(demos[demo].low, s.pitch + dy));
        change();
    }
    function zoom(factor) {
        const s = state[demo], d = demos[demo];
        s.distance = Math.min(d.far, Math.max(d.near, s.distance * factor));
        change();
    }
    const fingers = new Map();
    function spread() {
        const [a, b] = [...fingers.values()];
        return Math.hypot(a.x - b.x, a.y - b.y);
    }
    canvas.addEventListener('pointerdown', e => {
        canvas.setPointerCapture(e.pointerId);
        fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
        canvas.classList.add('turning');
    });
    canvas.addEventListener('pointermove', e => {
        const p = fingers.get(e.pointerId);
        if (!p) return;
        const dx = e.clientX - p.x, dy = e.clientY - p.y, before = fingers.size === 2 ? spread() : 0;
        p.x = e.clientX;
        p.y = e.clientY;
        if (fingers.size === 2) { if (before > 0 && spread() > 0) zoom(before / spread()); }
        else if (fingers.size === 1 && (dx || dy)) turn(0.007 * dx, 0.007 * dy);
    });
    for (const name of ['pointerup', 'pointercancel']) canvas.addEventListener(name, e => {
        fingers.delete(e.pointerId);
        if (fingers.size === 0) canvas.classList.remove('turning');
    });
    canvas.addEventListener('wheel', e => {
        e.preventDefault();
        zoom(Math.exp(0.0015 * Math.max(-200, Math.min(200, e.deltaY * (e.deltaMode ? 30 : 1)))));
    }, { passive: false });
    canvas.addEventListener('keydown', e => {
        const s = 0.08;
        switch (e.key) {
        case 'ArrowLeft': turn(s, 0); break;
        case 'ArrowRight': turn(-s, 0); break;
        case 'ArrowUp': turn(0, s); break;
        case 'ArrowDown': turn(0, -s); break;
        case '+': case '=': zoom(1 / 1.1); break;
        case '-': zoom(1.1); break;
        case 'Home': $('home').click(); break;
        default: return;
        }
        e.preventDefault();
    });
    new ResizeObserver(() => { if (ready) change(); }).observe(stage);

    // ---- start ----

    describe();
    if (typeof WebAssembly !== 'object' || typeof Worker !== 'function') {
        fail('This browser has no WebAssembly, which the libraries are compiled to.');
        return;
    }
    if (location.protocol === 'file:') {
        fail('A browser starts no workers from a file: serve this folder, for example with: node serve.js');
        return;
    }
    worker = new Worker('worker.js' + location.search);
    worker.onmessage = e => answer(e.data);
    worker.onerror = e => fail('The code could not be loaded: ' + (e.message || 'worker.js'));
})();
