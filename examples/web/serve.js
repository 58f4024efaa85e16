/* serve.js - serves a folder to this machine's browsers, with the headers that threads of WebAssembly need
   SPDX-License-Identifier: MIT OR Unlicense

       node serve.js [folder [port]]      without arguments: this folder, 8080

   Any other server does; without Cross-Origin-Opener-Policy and Cross-Origin-Embedder-Policy there are no threads. */
'use strict';
const http = require('http'), fs = require('fs'), path = require('path');
const types = { '.html': 'text/html', '.js': 'text/javascript', '.wasm': 'application/wasm' };

/* Serve `folder` on 127.0.0.1; port 0: any. isolated: with the two headers. Calls back with the server. */
exports.serve = function (folder, port, isolated, done) {
    const root = path.resolve(folder);
    const server = http.createServer((request, response) => {
        let name;
        try { name = decodeURIComponent(request.url.replace(/[?#].*/, '')); } catch (e) { name = '/'; }
        const file = path.join(root, name.endsWith('/') ? name + 'index.html' : name);
        if (file !== root && !file.startsWith(root + path.sep)) { response.writeHead(403).end(); return; }
        fs.readFile(file, (error, data) => {
            if (error) { response.writeHead(404).end('not found'); return; }
            const headers = { 'Content-Type': types[path.extname(file)] || 'application/octet-stream', 'Content-Length': data.length, 'Cache-Control': 'no-cache' };
            if (isolated) {
                headers['Cross-Origin-Opener-Policy'] = 'same-origin';
                headers['Cross-Origin-Embedder-Policy'] = 'require-corp';
            }
            response.writeHead(200, headers).end(data);
        });
    });
    server.listen(port, '127.0.0.1', () => done(server));
};

if (require.main === module) {
    exports.serve(process.argv[2] || __dirname, Number(process.argv[3] || 8080), true, server =>
        console.log('http://127.0.0.1:' + server.address().port + '/'));
}
