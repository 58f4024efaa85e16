/* test.js - the page in Chromium without a window: drawn, turned, touched, with and without threads
   SPDX-License-Identifier: MIT OR Unlicense

       node examples/web/test.js build/web        CHROMIUM=program; pictures are written to build/web/test/

   Speaks to the browser through a pipe, in the protocol of its developer tools; needs no package. */
'use strict';
const fs = require('fs'), os = require('os'), path = require('path');
const { spawn, spawnSync } = require('child_process');
const { serve } = require('./serve.js');

const folder = process.argv[2] || 'build/web', pictures = path.join(folder, 'test');
const programs = process.env.CHROMIUM ? [process.env.CHROMIUM] : ['chromium', 'chromium-browser', 'google-chrome'];
const program = programs.find(p => spawnSync(p, ['--version']).status === 0);
if (!program) { console.log('web-test: skipped, there is no chromium'); process.exit(0); }
const seconds = Number(process.env.WEB_SECONDS) || 240; // for one step: other programs may be at work
let passed = 0, failed = 0;

function check(ok, text) {
    if (ok) passed++;
    else failed++;
    console.log((ok ? 'ok    ' : 'FAIL  ') + text);
}

/* A browser: send(method, params, session) returns a promise. */
function browse() {
    const home = fs.mkdtempSync(path.join(os.tmpdir(), 'web-test-'));
    const child = spawn(program, ['--headless=new', '--no-sandbox', '--disable-gpu', '--no-first-run', '--remote-debugging-pipe',
        '--user-data-dir=' + home], { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
    const waiting = new Map();
    let next = 1, rest = '';
    child.stdio[4].on('data', data => {
        const parts = (rest + data).split('\0');
        rest = parts.pop();
        for (const p of parts) {
            const m = JSON.parse(p), w = waiting.get(m.id);
            if (!w) continue;
            waiting.delete(m.id);
            if (m.error) w.reject(new Error(m.error.message));
            else w.resolve(m.result);
        }
    });
    return {
        send: (method, params, sessionId) => new Promise((resolve, reject) => {
            waiting.set(next, { resolve, reject });
            child.stdio[3].write(JSON.stringify({ id: next++, method, params: params || {}, sessionId }) + '\0');
        }),
        close: () => new Promise(done => {
            child.on('exit', () => { 
                try { fs.rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 200 }); } catch (e) {
                    console.log(`left behind: ${home} (${e.code})`); /* a helper of the browser still writes there */
                }
                done();
            });
            child.kill();
        })
    };
}

/* A page: the functions below. before: a script that runs first. */
async function open(browser, url, width, height, dark, phone, before) {
    const { targetId } = await browser.send('Target.createTarget', { url: 'about:blank' });
    const { sessionId } = await browser.send('Target.attachToTarget', { targetId, flatten: true });
    const send = (method, params) => browser.send(method, params, sessionId);
    await send('Page.enable');
    await send('Emulation.setDeviceMetricsOverride', { width, height, deviceScaleFactor: phone ? 2 : 1, mobile: phone });
    await send('Emulation.setEmulatedMedia', { features: [{ name: 'prefers-color-scheme', value: dark ? 'dark' : 'light' }] });
    if (phone) await send('Emulation.setTouchEmulationEnabled', { enabled: true });
    if (before) await send('Page.addScriptToEvaluateOnNewDocument', { source: before });
    await send('Page.navigate', { url });
    const value = async expression => (await send('Runtime.evaluate', { expression, returnByValue: true })).result.value;
    const text = id => value(`document.getElementById('${id}').textContent`);
    const until = async expression => {
        const end = Date.now() + 1000 * seconds;
        while (Date.now() < end) {
            if (await value(expression)) return true;
            if (await value(`document.getElementById('veil') !== null && document.getElementById('veil').classList.contains('bad')`)) break;
            await new Promise(r => setTimeout(r, 100));
        }
        console.log('      waited for ' + expression + '; the page says: ' + await text('message'));
        return false;
    };
    return {
        send, value, text, until,
        drawn: samples => until(`document.getElementById('veil').hidden && document.getElementById('canvas').dataset.drawn >= 0 && ` +
            `document.getElementById('canvas').dataset.samples >= ${samples}`),
        number: () => value(`Number(document.getElementById('canvas').dataset.drawn)`),
        picture: () => value(`document.getElementById('canvas').toDataURL()`),
        colours: () => value(`(() => { const c = document.getElementById('canvas'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data, s = new Set();
            for (let i = 0; i < d.length; i += 4) s.add(d[i] << 16 | d[i + 1] << 8 | d[i + 2]); return s.size; })()`),
        middle: () => value(`(() => { const r = document.getElementById('canvas').getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()`),
        shoot: async name => {
            const { data } = await send('Page.captureScreenshot', { format: 'png' });
            fs.mkdirSync(pictures, { recursive: true });
            fs.writeFileSync(path.join(pictures, name + '.png'), Buffer.from(data, 'base64'));
        },
        close: () => browser.send('Target.closeTarget', { targetId })
    };
}

async function turned(page, what, act) { // act must lead to a new view and another picture
    const before = await page.picture(), number = await page.number();
    await act();
    const ok = await page.until(`Number(document.getElementById('canvas').dataset.drawn) > ${number}`);
    check(ok && await page.drawn(1) && await page.picture() !== before, what + ' changes the picture');
}
async function drag(page) {
    const [x, y] = await page.middle();
    await page.send('Input.dispatchMouseEvent', { type: 'mousePressed', x, y, button: 'left', buttons: 1, clickCount: 1 });
    for (let i = 1; i <= 4; i++) await page.send('Input.dispatchMouseEvent', { type: 'mouseMoved', x: x + 20 * i, y: y + 6 * i, button: 'left', buttons: 1 });
    await page.send('Input.dispatchMouseEvent', { type: 'mouseReleased', x: x + 80, y: y + 24, button: 'left', buttons: 0, clickCount: 1 });
}
async function click(page, id) {
    const [x, y] = await page.value(`(() => { const r = document.getElementById('${id}').getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()`);
    for (const type of ['mousePressed', 'mouseReleased']) await page.send('Input.dispatchMouseEvent', { type, x, y, button: 'left', clickCount: 1 });
}

async function press(page, id, key, windowsVirtualKeyCode) {
    await page.value(`document.getElementById('${id}').focus()`);
    for (const type of ['rawKeyDown', 'keyUp']) await page.send('Input.dispatchKeyEvent', { type, key, code: key, windowsVirtualKeyCode });
}

async function run() {
    const browser = browse();
    const isolated = await new Promise(done => serve(folder, 0, true, done)), plain = await new Promise(done => serve(folder, 0, false, done));
    const at = server => 'http://127.0.0.1:' + server.address().port + '/';
    const names = ['voxrt', 'zbufrand', 'tetcast'];
    const limit = setTimeout(() => { console.log('FAIL  took too long'); process.exit(1); }, 4000 * seconds);

    let page = await open(browser, at(isolated), 1200, 760, false, false);
    for (let i = 0; i < 3; i++) {
        if (i > 0) await click(page, 'tab' + i);
        if (i > 0) await page.until(`document.getElementById('error').textContent === '-'`);
        check(await page.drawn(2), names[i] + ': a picture, and two samples of the reference');
        check(await page.colours() > 100, names[i] + ': it shows something');
        check(/^\d+\.\d\d of 255$/.test(await page.text('error')) && parseFloat(await page.text('error')) < 64, names[i] + ': an error, ' + await page.text('error'));
        check(/ms$/.test(await page.text('time')), names[i] + ': ' + await page.text('time') + ' for ' + await page.text('size'));
        await page.shoot(names[i]);
        await turned(page, names[i] + ': dragging', () => drag(page));
    }
    check(/\d+ threads|one thread/.test(await page.text('machine')), await page.text('machine'));
    const cores = await page.value('navigator.hardwareConcurrency');
    check(cores < 2 || /SIMD, \d+ threads/.test(await page.text('machine')), 'threads where the server allows them and there are ' + cores + ' cores');
    await turned(page, 'an arrow key', () => press(page, 'canvas', 'ArrowLeft', 37));
    await turned(page, 'the key Home', () => press(page, 'canvas', 'Home', 36));
    const exact = parseFloat(await page.text('error'));
    const drawn = await page.number(); // the slider changes what is seen while moving, not the reference
    await press(page, 'tolerance', 'End', 35);
    await page.until(`Number(document.getElementById('canvas').dataset.drawn) > ${drawn}`);
    check(await page.drawn(1) && parseFloat(await page.text('error')) > exact, 'the largest tolerance: ' + await page.text('error') + ', not ' + exact.toFixed(2));
    await turned(page, 'the error, shown', () => click(page, 'difference'));
    await page.shoot('error');
    await turned(page, 'the error, hidden', () => click(page, 'difference'));
    await turned(page, 'the wheel', async () => {
        const [x, y] = await page.middle();
        await page.send('Input.dispatchMouseEvent', { type: 'mouseWheel', x, y, deltaX: 0, deltaY: 120 });
    });
    await page.close();

    page = await open(browser, at(plain), 390, 844, true, true);
    check(await page.drawn(1), 'without the headers: a picture');
    check(/one thread/.test(await page.text('machine')), 'without the headers: ' + await page.text('machine'));
    await page.shoot('phone');
    await turned(page, 'a finger', async () => {
        const [x, y] = await page.middle();
        await page.send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: [{ x, y }] });
        for (let i = 1; i <= 4; i++) await page.send('Input.dispatchTouchEvent', { type: 'touchMove', touchPoints: [{ x: x + 15 * i, y }] });
        await page.send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] });
    });
    await turned(page, 'two fingers', async () => {
        const [x, y] = await page.middle(), at = d => [{ x: x - d, y, id: 0 }, { x: x + d, y, id: 1 }];
        await page.send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: at(20) });
        for (let i = 1; i <= 4; i++) await page.send('Input.dispatchTouchEvent', { type: 'touchMove', touchPoints: at(20 + 10 * i) });
        await page.send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] });
    });
    check(await page.value('document.documentElement.scrollWidth <= window.innerWidth'), 'nothing is wider than the phone');
    await page.close();

    page = await open(browser, at(plain), 800, 600, false, false, 'delete window.WebAssembly;');
    await new Promise(r => setTimeout(r, 500));
    check(/no WebAssembly/.test(await page.text('message')), 'without WebAssembly the page says so');
    await page.close();

    clearTimeout(limit);
    await browser.close();
    isolated.close();
    plain.close();
    console.log(passed + ' passed, ' + failed + ' failed; pictures are in ' + pictures);
    process.exit(failed ? 1 : 0);
}
run().catch(e => { console.log('FAIL  ' + e.message); process.exit(1); });
