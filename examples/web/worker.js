/* worker.js - loads the WebAssembly and draws what page.js asks for
   SPDX-License-Identifier: MIT OR Unlicense */
'use strict';
(function () {
    let module = null, memory = null, view = 0, shape = null;

    const say = (text, part) => self.postMessage({ what: 'progress', text, part });
    const text = pointer => {
        const bytes = new Uint8Array(memory.buffer);
        let end = pointer;
        while (bytes[end]) end++;
        return new TextDecoder().decode(bytes.slice(pointer, end));
    };
    const check = pointer => { if (pointer) throw new Error(text(pointer)); };

    // (module (func (result v128) i32.const 0 i8x16.splat))
    const simd = WebAssembly.validate(new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 8, 1, 6, 0, 65, 0, 253, 15, 11]));

    async function load(name) { // with the part that is there
        const answer = await fetch(name);
        if (!answer.ok) throw new Error(name + ': ' + answer.status);
        const size = Number(answer.headers.get('Content-Length')) || 0, reader = answer.body.getReader(), parts = [];
        let have = 0;
        for (;;) {
            const { done, value } = await reader.read();
            if (done) break;
            parts.push(value);
            have += value.length;
            say('Loading the code, ' + Math.round(have / 1000) + ' KB', size > 0 ? Math.min(1, have / size) : undefined);
        }
        const all = new Uint8Array(have);
        let at = 0;
        for (const p of parts) { all.set(p, at); at += p.length; }
        return all.buffer;
    }

    async function start() {
        const asked = Number(new URLSearchParams(location.search).get('threads')) || 64;
        const cores = Math.min(navigator.hardwareConcurrency || 1, 16, asked);
        const shared = typeof SharedArrayBuffer === 'function' && self.crossOriginIsolated === true && simd;
        const name = shared && cores > 1 ? 'demo-threads' : 'demo';
        const why = cores < 2 ? '' : shared ? '' : !simd ? 'this browser has no WebAssembly SIMD' : 'the server does not send the headers that threads need';
        const wasmBinary = await load(name + '.wasm');
        say('Starting');
        importScripts(name + '.js');
        const initial = 1024, maximum = 16384; // 64 MB and 1 GB in pages of 64 KB, as web.mk says
        memory = name === 'demo' ? new WebAssembly.Memory({ initial, maximum }) : new WebAssembly.Memory({ initial, maximum, shared: true });
        module = await createDemo({ wasmBinary, wasmMemory: memory, mainScriptUrlOrBlob: name + '.js', poolSize: cores });
        view = module._malloc(6 * 8);
        const threads = module._web_start(name === 'demo' ? 1 : cores);
        self.postMessage({ what: 'ready', threads, why, simd: name !== 'demo' });
    }

    function picture(which, width, height) {
        const pointer = module._web_pixels(which), n = 4 * width * height, out = new Uint8Array(n);
        out.set(new Uint8Array(memory.buffer, pointer, n));
        return out.buffer;
    }
    function send(m) { self.postMessage(m, [m.pixels]); }

    function work(m) {
        if (m.what === 'open') {
            check(module._web_open(m.demo));
            self.postMessage({ what: 'open', demo: m.demo, text: text(module._web_text(m.demo)) });
        } else if (m.what === 'quick') {
            new Float64Array(memory.buffer, view, 6).set(m.view);
            const before = performance.now();
            check(module._web_quick(m.demo, view, m.width, m.height, m.step, m.tolerance));
            const ms = performance.now() - before;
            const width = Math.ceil(m.width / m.step), height = Math.ceil(m.height / m.step);
            shape = { width: m.width, height: m.height, samples: 0 };
            send({ what: 'quick', demo: m.demo, number: m.number, ms, width, height, step: m.step, pixels: picture(0, width, height) });
        } else if (m.what === 'refine') {
            check(module._web_refine());
            const error = module._web_error();
            send({ what: 'refine', number: m.number, samples: ++shape.samples, error, step: 1, width: shape.width, height: shape.height,
                   pixels: picture(m.difference ? 2 : 1, shape.width, shape.height) });
        }
    }

    const failed = e => self.postMessage({ what: 'failed', text: 'That did not work: ' + (e && e.message || e) });
    self.onmessage = e => { try { work(e.data); } catch (error) { failed(error); } };
    start().catch(failed);
})();
