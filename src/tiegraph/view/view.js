// sha256 of web: 2c901a844b89f576552aad93d01cf70b617bfe1d396a4ba1396a353f5fa30b81
// With three (MIT), copc (MIT) and laz-perf (Apache-2.0): licences.txt
(()=>{var Y_=Object.create;var ia=Object.defineProperty;var $_=Object.getOwnPropertyDescriptor;var K_=Object.getOwnPropertyNames;var Z_=Object.getPrototypeOf,J_=Object.prototype.hasOwnProperty;var Fu=(i=>typeof require<"u"?require:typeof Proxy<"u"?new Proxy(i,{get:(e,t)=>(typeof require<"u"?require:e)[t]}):i)(function(i){if(typeof require<"u")return require.apply(this,arguments);throw Error('Dynamic require of "'+i+'" is not supported')});var j_=(i,e,t)=>()=>{if(t)throw t[0];try{return i&&(e=i(i=0)),e}catch(n){throw t=[n],n}};var xt=(i,e)=>()=>{try{return e||i((e={exports:{}}).exports,e),e.exports}catch(t){throw e=0,t}},Q_=(i,e)=>{for(var t in e)ia(i,t,{get:e[t],enumerable:!0})},Du=(i,e,t,n)=>{if(e&&typeof e=="object"||typeof e=="function")for(let r of K_(e))!J_.call(i,r)&&r!==t&&ia(i,r,{get:()=>e[r],enumerable:!(n=$_(e,r))||n.enumerable});return i};var Lu=(i,e,t)=>(t=i!=null?Y_(Z_(i)):{},Du(e||!i||!i.__esModule?ia(t,"default",{value:i,enumerable:!0}):t,i)),ex=i=>Du(ia({},"__esModule",{value:!0}),i);var wm=xt(Rm=>{"use strict";Object.defineProperty(Rm,"__esModule",{value:!0})});var Cm=xt(bl=>{"use strict";Object.defineProperty(bl,"__esModule",{value:!0});bl.Hierarchy=void 0;bl.Hierarchy={parse:UM};function UM(i){return Object.entries(i).reduce((e,[t,n])=>(n===-1?e.pages[t]={}:n&&(e.nodes[t]={pointCount:n}),e),{nodes:{},pages:{}})}});var Fm=xt(cr=>{"use strict";var IM=cr&&cr.__createBinding||(Object.create?(function(i,e,t,n){n===void 0&&(n=t);var r=Object.getOwnPropertyDescriptor(e,t);(!r||("get"in r?!e.__esModule:r.writable||r.configurable))&&(r={enumerable:!0,get:function(){return e[t]}}),Object.defineProperty(i,n,r)}):(function(i,e,t,n){n===void 0&&(n=t),i[n]=e[t]})),Pm=cr&&cr.__exportStar||function(i,e){for(var t in i)t!=="default"&&!Object.prototype.hasOwnProperty.call(e,t)&&IM(e,i,t)};Object.defineProperty(cr,"__esModule",{value:!0});Pm(wm(),cr);Pm(Cm(),cr)});var Tl=xt(Rs=>{"use strict";Object.defineProperty(Rs,"__esModule",{value:!0});Rs.hierarchyItemLength=Rs.infoLength=void 0;Rs.infoLength=160;Rs.hierarchyItemLength=32});var Al=xt(ur=>{"use strict";Object.defineProperty(ur,"__esModule",{value:!0});ur.evlrHeaderLength=ur.vlrHeaderLength=ur.minHeaderLength=void 0;ur.minHeaderLength=375;ur.vlrHeaderLength=54;ur.evlrHeaderLength=60});var Dm=xt(ws=>{"use strict";Object.defineProperty(ws,"__esModule",{value:!0});ws.getBigUint64=ws.parseBigInt=void 0;function OM(i){if(i>BigInt(Number.MAX_SAFE_INTEGER)||i<BigInt(-Number.MAX_SAFE_INTEGER))throw new Error(`Cannot convert bigint to number: ${i}`);return Number(i)}ws.parseBigInt=OM;function NM(i,e,t){if(i.getBigUint64)return i.getBigUint64(e,t);let[n,r]=t?[4,0]:[0,4],s=BigInt(i.getUint32(e+n,t)),o=BigInt(i.getUint32(e+r,t));return(s<<BigInt(32))+o}ws.getBigUint64=NM});var Um=xt(fr=>{"use strict";Object.defineProperty(fr,"__esModule",{value:!0});fr.toCString=fr.toDataView=fr.Binary=void 0;fr.Binary={toDataView:eu,toCString:Lm};function eu(i){return new DataView(i.buffer,i.byteOffset,i.length)}fr.toDataView=eu;function Lm(i){let e=eu(i),t="";for(let n=0;n<e.byteLength;++n){let r=e.getInt8(n);if(r===0)return t;t+=String.fromCharCode(r)}return t}fr.toCString=Lm});var Gm=xt(Rl=>{"use strict";Object.defineProperty(Rl,"__esModule",{value:!0});Rl.Bounds=void 0;Rl.Bounds={min:BM,max:GM,mid:tu,width:Im,depth:Om,height:Nm,cube:zM,step:Bm,stepTo:kM,intersection:HM};function BM(i){return[i[0],i[1],i[2]]}function GM(i){return[i[3],i[4],i[5]]}function tu([i,e,t,n,r,s]){return[i+(n-i)/2,e+(r-e)/2,t+(s-t)/2]}function Im(i){return i[3]-i[0]}function Om(i){return i[4]-i[1]}function Nm(i){return i[5]-i[2]}function zM(i){let e=tu(i),t=Math.max(Im(i),Om(i),Nm(i))/2;return[e[0]-t,e[1]-t,e[2]-t,e[0]+t,e[1]+t,e[2]+t]}function Bm(i,[e,t,n]){let[r,s,o,a,l,c]=i,[u,h,d]=tu(i);return[e?u:r,t?h:s,n?d:o,e?a:u,t?l:h,n?c:d]}function kM(i,[e,t,n,r]){for(let s=e-1;s>=0;--s)i=Bm(i,[t>>s&1,n>>s&1,r>>s&1]);return i}function HM(i,e){return[Math.max(i[0],e[0]),Math.max(i[1],e[1]),Math.max(i[2],e[2]),Math.min(i[3],e[3]),Math.min(i[4],e[4]),Math.min(i[5],e[5])]}});var zm=xt(wl=>{"use strict";Object.defineProperty(wl,"__esModule",{value:!0});wl.Dimension=void 0;var VM={int8:{type:"signed",size:1},int16:{type:"signed",size:2},int32:{type:"signed",size:4},int64:{type:"signed",size:8},uint8:{type:"unsigned",size:1},uint16:{type:"unsigned",size:2},uint32:{type:"unsigned",size:4},uint64:{type:"unsigned",size:8},float32:{type:"float",size:4},float64:{type:"float",size:8},float:{type:"float",size:4},double:{type:"float",size:8},bool:{type:"unsigned",size:1},boolean:{type:"unsigned",size:1}};wl.Dimension={Type:VM,ctype:WM};function WM({type:i,size:e}){switch(i){case"signed":switch(e){case 1:return"int8";case 2:return"int16";case 4:return"int32";case 8:return"int64"}case"unsigned":switch(e){case 1:return"uint8";case 2:return"uint16";case 4:return"uint32";case 8:return"uint64"}case"float":switch(e){case 4:return"float";case 8:return"double"}}throw new Error(`Invalid dimension type/size: ${i}/${e}`)}});var km={};Q_(km,{default:()=>XM});function XM(){throw new Error("not used")}var Hm=j_(()=>{});var Vm=xt(()=>{});var qm=xt(rn=>{"use strict";var qM=rn&&rn.__createBinding||(Object.create?(function(i,e,t,n){n===void 0&&(n=t);var r=Object.getOwnPropertyDescriptor(e,t);(!r||("get"in r?!e.__esModule:r.writable||r.configurable))&&(r={enumerable:!0,get:function(){return e[t]}}),Object.defineProperty(i,n,r)}):(function(i,e,t,n){n===void 0&&(n=t),i[n]=e[t]})),YM=rn&&rn.__setModuleDefault||(Object.create?(function(i,e){Object.defineProperty(i,"default",{enumerable:!0,value:e})}):function(i,e){i.default=e}),$M=rn&&rn.__importStar||function(i){if(i&&i.__esModule)return i;var e={};if(i!=null)for(var t in i)t!=="default"&&Object.prototype.hasOwnProperty.call(i,t)&&qM(e,i,t);return YM(e,i),e},KM=rn&&rn.__importDefault||function(i){return i&&i.__esModule?i:{default:i}};Object.defineProperty(rn,"__esModule",{value:!0});rn.Getter=void 0;var ZM=KM((Hm(),ex(km)));rn.Getter={create:JM,http:Wm,file:Xm};function JM(i){return typeof i=="function"?i:i.startsWith("http://")||i.startsWith("https://")?Wm(i):Xm(i)}function Wm(i){return async function(t,n){if(t<0||n<0||t>n)throw new Error("Invalid range");let s=await(await(0,ZM.default)(i,{headers:{Range:`bytes=${t}-${n-1}`}})).arrayBuffer();return new Uint8Array(s)}}function Xm(i){return async function(t,n){let r=await Promise.resolve().then(()=>$M(Vm()));async function s(o=0,a=1/0){if(o<0||a<0||o>a)throw new Error("Invalid range");await r.promises.access(i);let l=r.createReadStream(i,{start:o,end:a-1,autoClose:!0});return jM(l)}return s(t,n)}}async function jM(i){return await new Promise((e,t)=>{let n=[];i.on("data",r=>n.push(r)),i.on("error",t),i.on("end",()=>e(Buffer.concat(n)))})}});var $m=xt(Cs=>{"use strict";Object.defineProperty(Cs,"__esModule",{value:!0});Cs.Key=void 0;Cs.Key={create:QM,parse:Ym,toString:ey,step:ty,up:iy,compare:ny,depth:ry};function QM(i,e=0,t=0,n=0){return typeof i!="number"?Ym(i):[i,e,t,n]}function Ym(i){if(typeof i!="string")return i;let[e,t,n,r,...s]=i.split("-").map(a=>parseInt(a,10)),o=[e,t,n,r];if(s.length!==0||o.some(a=>typeof a!="number"||Number.isNaN(a)))throw new Error(`Invalid key: ${i}`);return o}function ey(i){return typeof i=="string"?i:i.join("-")}function ty(i,[e,t,n]){let[r,s,o,a]=Cs.Key.create(i);return[r+1,s*2+e,o*2+t,a*2+n]}function iy(i,e=1){let[t,n,r,s]=Cs.Key.create(i);return[t-e,n>>e,r>>e,s>>e]}function ny(i,e){for(let t=0;t<i.length;++t){if(i[t]<e[t])return-1;if(i[t]>e[t])return 1}return 0}function ry(i){return i[0]}});var Km=xt(Cl=>{"use strict";Object.defineProperty(Cl,"__esModule",{value:!0});Cl.Scale=void 0;Cl.Scale={apply:(i,e=1,t=0)=>(i-t)/e,unapply:(i,e=1,t=0)=>i*e+t}});var Zm=xt(Pl=>{"use strict";Object.defineProperty(Pl,"__esModule",{value:!0});Pl.Step=void 0;Pl.Step={fromIndex:sy,list:oy};function sy(i){if(i<0||i>=8)throw new Error(`Invalid step index: ${i}`);let e=i>>0&1?1:0,t=i>>1&1?1:0,n=i>>2&1?1:0;return[e,t,n]}function oy(){return[[0,0,0],[0,0,1],[0,1,0],[0,1,1],[1,0,0],[1,0,1],[1,1,0],[1,1,1]]}});var sn=xt(Wt=>{"use strict";var ay=Wt&&Wt.__createBinding||(Object.create?(function(i,e,t,n){n===void 0&&(n=t);var r=Object.getOwnPropertyDescriptor(e,t);(!r||("get"in r?!e.__esModule:r.writable||r.configurable))&&(r={enumerable:!0,get:function(){return e[t]}}),Object.defineProperty(i,n,r)}):(function(i,e,t,n){n===void 0&&(n=t),i[n]=e[t]})),ly=Wt&&Wt.__exportStar||function(i,e){for(var t in i)t!=="default"&&!Object.prototype.hasOwnProperty.call(e,t)&&ay(e,i,t)};Object.defineProperty(Wt,"__esModule",{value:!0});Wt.Step=Wt.Scale=Wt.Key=Wt.Getter=Wt.Dimension=Wt.Bounds=Wt.Binary=void 0;ly(Dm(),Wt);var cy=Um();Object.defineProperty(Wt,"Binary",{enumerable:!0,get:function(){return cy.Binary}});var uy=Gm();Object.defineProperty(Wt,"Bounds",{enumerable:!0,get:function(){return uy.Bounds}});var fy=zm();Object.defineProperty(Wt,"Dimension",{enumerable:!0,get:function(){return fy.Dimension}});var hy=qm();Object.defineProperty(Wt,"Getter",{enumerable:!0,get:function(){return hy.Getter}});var dy=$m();Object.defineProperty(Wt,"Key",{enumerable:!0,get:function(){return dy.Key}});var py=Km();Object.defineProperty(Wt,"Scale",{enumerable:!0,get:function(){return py.Scale}});var my=Zm();Object.defineProperty(Wt,"Step",{enumerable:!0,get:function(){return my.Step}})});var iu=xt(Dl=>{"use strict";Object.defineProperty(Dl,"__esModule",{value:!0});Dl.ExtraBytes=void 0;var bi=sn();Dl.ExtraBytes={getDimension:gy,parse:_y,parseOne:Jm};var Fl=192;function gy({type:i,length:e}){switch(i){case"signed":case"unsigned":switch(e){case 1:case 2:case 4:case 8:return{type:i,size:e}}case"float":switch(e){case 4:case 8:return{type:i,size:e}}}}function _y(i){if(i.byteLength%Fl!==0)throw new Error(`Invalid extra bytes VLR length: ${i.byteLength}`);let e=[];for(let t=0;t<i.byteLength;t+=Fl)e.push(Jm(i.slice(t,t+Fl)));return e}function Jm(i){if(i.byteLength!==Fl)throw new Error(`Invalid extra bytes entry length: ${i.byteLength}`);let e=bi.Binary.toDataView(i),t=bi.Binary.toCString(i.slice(4,36)),n=bi.Binary.toCString(i.slice(60,192)),r=e.getUint8(2),s=e.getUint8(3);if(r>=11)throw new Error(`Invalid extra bytes "type" value: ${r}`);if(r===0)return{name:t,description:n,length:s};let o=My(s),a=xy(r);if(!a)throw new Error(`Failed to extract dimension type: ${r}`);let{type:l,size:c}=a;function u(d){switch(l){case"signed":return(0,bi.parseBigInt)(e.getBigInt64(d,!0));case"unsigned":return(0,bi.parseBigInt)((0,bi.getBigUint64)(e,d,!0));case"float":return e.getFloat64(d,!0)}}let h={name:t,description:n,type:l,length:c};return o.hasNodata&&(h.nodata=u(40)),o.hasMin&&(h.min=u(64)),o.hasMax&&(h.max=u(88)),o.hasScale&&(h.scale=e.getFloat64(112)),o.hasOffset&&(h.offset=e.getFloat64(136)),h}function xy(i){switch(i){case 1:return bi.Dimension.Type.uint8;case 2:return bi.Dimension.Type.int8;case 3:return bi.Dimension.Type.uint16;case 4:return bi.Dimension.Type.int16;case 5:return bi.Dimension.Type.uint32;case 6:return bi.Dimension.Type.int32;case 7:return bi.Dimension.Type.uint64;case 8:return bi.Dimension.Type.int64;case 9:return bi.Dimension.Type.float32;case 10:return bi.Dimension.Type.float64}}function My(i){return{hasNodata:!!(i&1),hasMin:!!(i>>1&1),hasMax:!!(i>>2&1),hasScale:!!(i>>3&1),hasOffset:!!(i>>4&1)}}});var nu=xt(Ll=>{"use strict";Object.defineProperty(Ll,"__esModule",{value:!0});Ll.Dimensions=void 0;var yy=sn(),vy=iu();Ll.Dimensions={create:Ey};var{Type:Gt}=yy.Dimension,Sy={X:Gt.float64,Y:Gt.float64,Z:Gt.float64,Intensity:Gt.uint16,ReturnNumber:Gt.uint8,NumberOfReturns:Gt.uint8,ScanDirectionFlag:Gt.boolean,EdgeOfFlightLine:Gt.boolean,Classification:Gt.uint8,Synthetic:Gt.boolean,KeyPoint:Gt.boolean,Withheld:Gt.boolean,Overlap:Gt.boolean,ScanAngle:Gt.float32,UserData:Gt.uint8,PointSourceId:Gt.uint16,GpsTime:Gt.float64,Red:Gt.uint16,Green:Gt.uint16,Blue:Gt.uint16,ScannerChannel:Gt.uint8,Infrared:Gt.uint16};function Ey(i,e=[]){return Object.keys(i).reduce((t,n)=>{let r=Sy[n];if(r)return{...t,[n]:r};let s=e.find(a=>a.name===n),o=s&&vy.ExtraBytes.getDimension(s);if(o)return{...t,[n]:o};throw new Error(`Failed to look up LAS type: ${n}`)},{})}});var ru=xt(Il=>{"use strict";Object.defineProperty(Il,"__esModule",{value:!0});Il.Extractor=void 0;var Tn=sn();Il.Extractor={create:Ry};function by(i){switch(i){case 0:return 20;case 1:return 28;case 2:return 26;case 3:return 34;case 6:return 30;case 7:return 36;case 8:return 38;default:throw new Error(`Unsupported point data record format: ${i}`)}}function Ty(i,e,{type:t,length:n}){let r=hr(i);switch(t){case"signed":switch(n){case 1:return(s,o)=>s.getInt8(r(o)+e);case 2:return(s,o)=>s.getInt16(r(o)+e,!0);case 4:return(s,o)=>s.getInt32(r(o)+e,!0);case 8:return(s,o)=>(0,Tn.parseBigInt)(s.getBigInt64(r(o)+e,!0))}case"unsigned":switch(n){case 1:return(s,o)=>s.getUint8(r(o)+e);case 2:return(s,o)=>s.getUint16(r(o)+e,!0);case 4:return(s,o)=>s.getUint32(r(o)+e,!0);case 8:return(s,o)=>(0,Tn.parseBigInt)((0,Tn.getBigUint64)(s,r(o)+e,!0))}case"float":switch(n){case 4:return(s,o)=>s.getFloat32(r(o)+e,!0);case 8:return(s,o)=>s.getFloat64(r(o)+e,!0)}}}function Ay(i,e){let n=by(i.pointDataRecordFormat);return e.reduce((r,s)=>{let o=n;n+=s.length;let a=Ty(i,o,s);if(!a)return r;let l=(c,u)=>Tn.Scale.unapply(a(c,u),s.scale,s.offset);return{...r,[s.name]:l}},{})}function Ry(i,e=[]){let t=Ay(i,e);return{...(()=>{let{pointDataRecordFormat:r}=i;switch(r){case 0:return Ul(i);case 1:return wy(i);case 2:return Cy(i);case 3:return Py(i);case 6:return jm(i);case 7:return Qm(i);case 8:return Fy(i);default:throw new Error(`Unsupported point data record format: ${r}`)}})(),...t}}function Ul(i){let{scale:e,offset:t}=i,n=hr(i);function r(a,l){return a.getUint8(n(l)+14)}function s(a,l){return a.getUint8(n(l)+15)}function o(a,l){return s(a,l)&31}return{X:(a,l)=>Tn.Scale.unapply(a.getInt32(n(l),!0),e[0],t[0]),Y:(a,l)=>Tn.Scale.unapply(a.getInt32(n(l)+4,!0),e[1],t[1]),Z:(a,l)=>Tn.Scale.unapply(a.getInt32(n(l)+8,!0),e[2],t[2]),Intensity:(a,l)=>a.getUint16(n(l)+12,!0),ReturnNumber:(a,l)=>r(a,l)&7,NumberOfReturns:(a,l)=>(r(a,l)&56)>>3,ScanDirectionFlag:(a,l)=>(r(a,l)&64)>>6,EdgeOfFlightLine:(a,l)=>(r(a,l)&128)>>7,Classification:(a,l)=>{let c=o(a,l);return c===12?0:c},Synthetic:(a,l)=>(s(a,l)&32)>>5,KeyPoint:(a,l)=>(s(a,l)&64)>>6,Withheld:(a,l)=>(s(a,l)&128)>>7,Overlap:(a,l)=>o(a,l)===12?1:0,ScanAngle:(a,l)=>a.getInt8(n(l)+16),UserData:(a,l)=>a.getUint8(n(l)+17),PointSourceId:(a,l)=>a.getUint16(n(l)+18,!0)}}function wy(i){let e=hr(i);return{...Ul(i),GpsTime:(t,n)=>t.getFloat64(e(n)+20,!0)}}function Cy(i){let e=hr(i);return{...Ul(i),Red:(t,n)=>t.getUint16(e(n)+20,!0),Green:(t,n)=>t.getUint16(e(n)+22,!0),Blue:(t,n)=>t.getUint16(e(n)+24,!0)}}function Py(i){let e=hr(i);return{...Ul(i),GpsTime:(t,n)=>t.getFloat64(e(n)+20,!0),Red:(t,n)=>t.getUint16(e(n)+28,!0),Green:(t,n)=>t.getUint16(e(n)+30,!0),Blue:(t,n)=>t.getUint16(e(n)+32,!0)}}function jm(i){let{scale:e,offset:t}=i,n=hr(i);function r(s,o){return s.getUint8(n(o)+15)}return{X:(s,o)=>Tn.Scale.unapply(s.getInt32(n(o),!0),e[0],t[0]),Y:(s,o)=>Tn.Scale.unapply(s.getInt32(n(o)+4,!0),e[1],t[1]),Z:(s,o)=>Tn.Scale.unapply(s.getInt32(n(o)+8,!0),e[2],t[2]),Intensity:(s,o)=>s.getUint16(n(o)+12,!0),ReturnNumber:(s,o)=>s.getUint16(n(o)+14,!0)&15,NumberOfReturns:(s,o)=>(s.getUint16(n(o)+14,!0)&240)>>4,Synthetic:(s,o)=>r(s,o)&1,KeyPoint:(s,o)=>(r(s,o)&2)>>1,Withheld:(s,o)=>(r(s,o)&4)>>2,Overlap:(s,o)=>(r(s,o)&8)>>3,ScannerChannel:(s,o)=>(r(s,o)&48)>>4,ScanDirectionFlag:(s,o)=>(r(s,o)&64)>>6,EdgeOfFlightLine:(s,o)=>(r(s,o)&128)>>7,Classification:(s,o)=>s.getUint8(n(o)+16),UserData:(s,o)=>s.getUint8(n(o)+17),ScanAngle:(s,o)=>s.getInt16(n(o)+18,!0)*.006,PointSourceId:(s,o)=>s.getUint16(n(o)+20,!0),GpsTime:(s,o)=>s.getFloat64(n(o)+22,!0)}}function Qm(i){let e=hr(i);return{...jm(i),Red:(t,n)=>t.getUint16(e(n)+30,!0),Green:(t,n)=>t.getUint16(e(n)+32,!0),Blue:(t,n)=>t.getUint16(e(n)+34,!0)}}function Fy(i){let e=hr(i);return{...Qm(i),Infrared:(t,n)=>t.getUint16(e(n)+36,!0)}}function hr(i){let{pointDataRecordLength:e}=i;return function(n){return n*e}}});var tg=xt(Ps=>{"use strict";Object.defineProperty(Ps,"__esModule",{value:!0});Ps.formatGuid=Ps.parsePoint=void 0;var eg=sn();function Dy(i){let e=eg.Binary.toDataView(i);if(e.byteLength!==24)throw new Error(`Invalid tuple buffer length: ${e.byteLength}`);return[e.getFloat64(0,!0),e.getFloat64(8,!0),e.getFloat64(16,!0)]}Ps.parsePoint=Dy;function Ly(i){let e=eg.Binary.toDataView(i);if(e.byteLength!==16)throw new Error(`Invalid GUID buffer length: ${e.byteLength}`);let t="";for(let n=0;n<e.byteLength;n+=4){let r=e.getUint32(n,!0);t+=r.toString(16).padStart(8,"0")}return[t.slice(0,8),t.slice(8,12),t.slice(12,16),t.slice(16,32)].join("-")}Ps.formatGuid=Ly});var ou=xt(Ol=>{"use strict";Object.defineProperty(Ol,"__esModule",{value:!0});Ol.Header=void 0;var Ni=sn(),ig=Al(),su=tg();Ol.Header={parse:Uy};function Uy(i){if(i.byteLength<ig.minHeaderLength)throw new Error(`Invalid header: must be at least ${ig.minHeaderLength} bytes`);let e=Ni.Binary.toDataView(i),t=Ni.Binary.toCString(i.slice(0,4));if(t!=="LASF")throw new Error(`Invalid file signature: ${t}`);let n=e.getUint8(24),r=e.getUint8(25);if(n!==1||r!==2&&r!==4)throw new Error(`Invalid version (only 1.2 and 1.4 supported): ${n}.${r}`);let s={fileSignature:t,fileSourceId:e.getUint16(4,!0),globalEncoding:e.getUint16(6,!0),projectId:(0,su.formatGuid)(i.slice(8,24)),majorVersion:n,minorVersion:r,systemIdentifier:Ni.Binary.toCString(i.slice(26,58)),generatingSoftware:Ni.Binary.toCString(i.slice(58,90)),fileCreationDayOfYear:e.getUint16(90,!0),fileCreationYear:e.getUint16(92,!0),headerLength:e.getUint16(94,!0),pointDataOffset:e.getUint32(96,!0),vlrCount:e.getUint32(100,!0),pointDataRecordFormat:e.getUint8(104)&15,pointDataRecordLength:e.getUint16(105,!0),pointCount:e.getUint32(107,!0),pointCountByReturn:Oy(i.slice(111,131)),scale:(0,su.parsePoint)(i.slice(131,155)),offset:(0,su.parsePoint)(i.slice(155,179)),min:[e.getFloat64(187,!0),e.getFloat64(203,!0),e.getFloat64(219,!0)],max:[e.getFloat64(179,!0),e.getFloat64(195,!0),e.getFloat64(211,!0)],waveformDataOffset:0,evlrOffset:0,evlrCount:0};return r==2?s:{...s,pointCount:(0,Ni.parseBigInt)((0,Ni.getBigUint64)(e,247,!0)),pointCountByReturn:Iy(i.slice(255,375)),waveformDataOffset:(0,Ni.parseBigInt)((0,Ni.getBigUint64)(e,227,!0)),evlrOffset:(0,Ni.parseBigInt)((0,Ni.getBigUint64)(e,235,!0)),evlrCount:e.getUint32(243,!0)}}function Iy(i){let e=Ni.Binary.toDataView(i),t=[];for(let n=0;n<120;n+=8)t.push((0,Ni.getBigUint64)(e,n,!0));return t.map(n=>(0,Ni.parseBigInt)(n))}function Oy(i){let e=Ni.Binary.toDataView(i),t=[];for(let n=0;n<20;n+=4)t.push(e.getUint32(n,!0));return t}});var ng=xt((Nl,lu)=>{var au=(()=>{var i=typeof document<"u"&&document.currentScript?document.currentScript.src:void 0;return(function(e){e=e||{};var t=typeof e<"u"?e:{},n,r;t.ready=new Promise(function(f,p){n=f,r=p}),["_main","___getTypeName","__embind_initialize_bindings","_fflush","onRuntimeInitialized"].forEach(f=>{Object.getOwnPropertyDescriptor(t.ready,f)||Object.defineProperty(t.ready,f,{get:()=>oe("You are getting "+f+" on the Promise object, instead of the instance. Use .then() to get called back with the instance, see the MODULARIZE docs in src/settings.js"),set:()=>oe("You are setting "+f+" on the Promise object, instead of the instance. Use .then() to get called back with the instance, see the MODULARIZE docs in src/settings.js")})});var s=Object.assign({},t),o=[],a="./this.program",l=(f,p)=>{throw p},c=!0,u=!1,h=!1,d=!1;if(t.ENVIRONMENT)throw new Error("Module.ENVIRONMENT has been deprecated. To force the environment, use the ENVIRONMENT compile-time option (for example, -sENVIRONMENT=web or -sENVIRONMENT=node)");var g="";function M(f){return t.locateFile?t.locateFile(f,g):g+f}var S,_,m,b;function w(f){if(f instanceof ge)return;let p=f;f&&typeof f=="object"&&f.stack&&(p=[f,f.stack]),P("exiting due to exception: "+p)}if(d){if(typeof process=="object"&&typeof Fu=="function"||typeof window=="object"||typeof importScripts=="function")throw new Error("not compiled for this environment (did you build to HTML and try to run it not on the web, or set ENVIRONMENT to something - like node - and run it someplace else - like on the web?)");typeof read<"u"&&(S=function(p){return read(p)}),m=function(p){let E;return typeof readbuffer=="function"?new Uint8Array(readbuffer(p)):(E=read(p,"binary"),O(typeof E=="object"),E)},_=function(p,E,D){setTimeout(()=>E(m(p)),0)},typeof scriptArgs<"u"?o=scriptArgs:typeof arguments<"u"&&(o=arguments),typeof quit=="function"&&(l=(f,p)=>{w(p),quit(f)}),typeof print<"u"&&(typeof console>"u"&&(console={}),console.log=print,console.warn=console.error=typeof printErr<"u"?printErr:print)}else if(c||u){if(u?g=self.location.href:typeof document<"u"&&document.currentScript&&(g=document.currentScript.src),i&&(g=i),g.indexOf("blob:")!==0?g=g.substr(0,g.replace(/[?#].*/,"").lastIndexOf("/")+1):g="",!(typeof window=="object"||typeof importScripts=="function"))throw new Error("not compiled for this environment (did you build to HTML and try to run it not on the web, or set ENVIRONMENT to something - like node - and run it someplace else - like on the web?)");S=f=>{var p=new XMLHttpRequest;return p.open("GET",f,!1),p.send(null),p.responseText},u&&(m=f=>{var p=new XMLHttpRequest;return p.open("GET",f,!1),p.responseType="arraybuffer",p.send(null),new Uint8Array(p.response)}),_=(f,p,E)=>{var D=new XMLHttpRequest;D.open("GET",f,!0),D.responseType="arraybuffer",D.onload=()=>{if(D.status==200||D.status==0&&D.response){p(D.response);return}E()},D.onerror=E,D.send(null)},b=f=>document.title=f}else throw new Error("environment detection error");var R=t.print||console.log.bind(console),P=t.printErr||console.warn.bind(console);Object.assign(t,s),s=null,O_(),t.arguments&&(o=t.arguments),x("arguments","arguments_"),t.thisProgram&&(a=t.thisProgram),x("thisProgram","thisProgram"),t.quit&&(l=t.quit),x("quit","quit_"),O(typeof t.memoryInitializerPrefixURL>"u","Module.memoryInitializerPrefixURL option was removed, use Module.locateFile instead"),O(typeof t.pthreadMainPrefixURL>"u","Module.pthreadMainPrefixURL option was removed, use Module.locateFile instead"),O(typeof t.cdInitializerPrefixURL>"u","Module.cdInitializerPrefixURL option was removed, use Module.locateFile instead"),O(typeof t.filePackagePrefixURL>"u","Module.filePackagePrefixURL option was removed, use Module.locateFile instead"),O(typeof t.read>"u","Module.read option was removed (modify read_ in JS)"),O(typeof t.readAsync>"u","Module.readAsync option was removed (modify readAsync in JS)"),O(typeof t.readBinary>"u","Module.readBinary option was removed (modify readBinary in JS)"),O(typeof t.setWindowTitle>"u","Module.setWindowTitle option was removed (modify setWindowTitle in JS)"),O(typeof t.TOTAL_MEMORY>"u","Module.TOTAL_MEMORY has been renamed Module.INITIAL_MEMORY"),x("read","read_"),x("readAsync","readAsync"),x("readBinary","readBinary"),x("setWindowTitle","setWindowTitle"),O(!u,"worker environment detected but not enabled at build time.  Add 'worker' to `-sENVIRONMENT` to enable."),O(!h,"node environment detected but not enabled at build time.  Add 'node' to `-sENVIRONMENT` to enable."),O(!d,"shell environment detected but not enabled at build time.  Add 'shell' to `-sENVIRONMENT` to enable.");var C=4;function x(f,p){Object.getOwnPropertyDescriptor(t,f)||Object.defineProperty(t,f,{configurable:!0,get:function(){oe("Module."+f+" has been replaced with plain "+p+" (the initial value can be provided on Module, but after startup the value is only looked for on a local variable of that name)")}})}function A(f){Object.getOwnPropertyDescriptor(t,f)&&oe("`Module."+f+"` was supplied but `"+f+"` not included in INCOMING_MODULE_JS_API")}function V(f){return f==="FS_createPath"||f==="FS_createDataFile"||f==="FS_createPreloadedFile"||f==="FS_unlink"||f==="addRunDependency"||f==="FS_createLazyFile"||f==="FS_createDevice"||f==="removeRunDependency"}function N(f){typeof globalThis<"u"&&!Object.getOwnPropertyDescriptor(globalThis,f)&&Object.defineProperty(globalThis,f,{configurable:!0,get:function(){var p="`"+f+"` is a library symbol and not included by default; add it to your library.js __deps or to DEFAULT_LIBRARY_FUNCS_TO_INCLUDE on the command line";V(f)&&(p+=". Alternatively, forcing filesystem support (-sFORCE_FILESYSTEM) can export this for you"),Xe(p)}})}function G(f){Object.getOwnPropertyDescriptor(t,f)||Object.defineProperty(t,f,{configurable:!0,get:function(){var p="'"+f+"' was not exported. add it to EXPORTED_RUNTIME_METHODS (see the FAQ)";V(f)&&(p+=". Alternatively, forcing filesystem support (-sFORCE_FILESYSTEM) can export this for you"),oe(p)}})}var W;t.wasmBinary&&(W=t.wasmBinary),x("wasmBinary","wasmBinary");var ee=t.noExitRuntime||!0;x("noExitRuntime","noExitRuntime"),typeof WebAssembly!="object"&&oe("no native wasm support detected");var U,$=!1,ne;function O(f,p){f||oe("Assertion failed"+(p?": "+p:""))}var ue=typeof TextDecoder<"u"?new TextDecoder("utf8"):void 0;function K(f,p,E){for(var D=p+E,Y=p;f[Y]&&!(Y>=D);)++Y;if(Y-p>16&&f.buffer&&ue)return ue.decode(f.subarray(p,Y));for(var se="";p<Y;){var ae=f[p++];if(!(ae&128)){se+=String.fromCharCode(ae);continue}var te=f[p++]&63;if((ae&224)==192){se+=String.fromCharCode((ae&31)<<6|te);continue}var pe=f[p++]&63;if((ae&240)==224?ae=(ae&15)<<12|te<<6|pe:((ae&248)!=240&&Xe("Invalid UTF-8 leading byte 0x"+ae.toString(16)+" encountered when deserializing a UTF-8 string in wasm memory to a JS string!"),ae=(ae&7)<<18|te<<12|pe<<6|f[p++]&63),ae<65536)se+=String.fromCharCode(ae);else{var we=ae-65536;se+=String.fromCharCode(55296|we>>10,56320|we&1023)}}return se}function re(f,p){return f?K(Ee,f,p):""}function le(f,p,E,D){if(!(D>0))return 0;for(var Y=E,se=E+D-1,ae=0;ae<f.length;++ae){var te=f.charCodeAt(ae);if(te>=55296&&te<=57343){var pe=f.charCodeAt(++ae);te=65536+((te&1023)<<10)|pe&1023}if(te<=127){if(E>=se)break;p[E++]=te}else if(te<=2047){if(E+1>=se)break;p[E++]=192|te>>6,p[E++]=128|te&63}else if(te<=65535){if(E+2>=se)break;p[E++]=224|te>>12,p[E++]=128|te>>6&63,p[E++]=128|te&63}else{if(E+3>=se)break;te>1114111&&Xe("Invalid Unicode code point 0x"+te.toString(16)+" encountered when serializing a JS string to a UTF-8 string in wasm memory! (Valid unicode code points should be in range 0-0x10FFFF)."),p[E++]=240|te>>18,p[E++]=128|te>>12&63,p[E++]=128|te>>6&63,p[E++]=128|te&63}}return p[E]=0,E-Y}function Ue(f,p,E){return O(typeof E=="number","stringToUTF8(str, outPtr, maxBytesToWrite) is missing the third parameter that specifies the length of the output buffer!"),le(f,Ee,p,E)}function Ze(f){for(var p=0,E=0;E<f.length;++E){var D=f.charCodeAt(E);D<=127?p++:D<=2047?p+=2:D>=55296&&D<=57343?(p+=4,++E):p+=3}return p}var Q,_e,Ee,Ge,be,Fe,Ye,Ve,dt;function yt(f){Q=f,t.HEAP8=_e=new Int8Array(f),t.HEAP16=Ge=new Int16Array(f),t.HEAP32=Fe=new Int32Array(f),t.HEAPU8=Ee=new Uint8Array(f),t.HEAPU16=be=new Uint16Array(f),t.HEAPU32=Ye=new Uint32Array(f),t.HEAPF32=Ve=new Float32Array(f),t.HEAPF64=dt=new Float64Array(f)}var st=65536;t.TOTAL_STACK&&O(st===t.TOTAL_STACK,"the stack size can no longer be determined at runtime");var zt=t.INITIAL_MEMORY||262144;x("INITIAL_MEMORY","INITIAL_MEMORY"),O(zt>=st,"INITIAL_MEMORY should be larger than TOTAL_STACK, was "+zt+"! (TOTAL_STACK="+st+")"),O(typeof Int32Array<"u"&&typeof Float64Array<"u"&&Int32Array.prototype.subarray!=null&&Int32Array.prototype.set!=null,"JS engine does not provide full typed array support"),O(!t.wasmMemory,"Use of `wasmMemory` detected.  Use -sIMPORTED_MEMORY to define wasmMemory externally"),O(zt==262144,"Detected runtime INITIAL_MEMORY setting.  Use -sIMPORTED_MEMORY to define wasmMemory dynamically");var bt;function pi(){var f=nc();O((f&3)==0),Ye[f>>2]=34821223,Ye[f+4>>2]=2310721022,Ye[0]=1668509029}function At(){if(!$){var f=nc(),p=Ye[f>>2],E=Ye[f+4>>2];(p!=34821223||E!=2310721022)&&oe("Stack overflow! Stack cookie has been overwritten at 0x"+f.toString(16)+", expected hex dwords 0x89BACDFE and 0x2135467, but received 0x"+E.toString(16)+" 0x"+p.toString(16)),Ye[0]!==1668509029&&oe("Runtime error: The application has corrupted its heap memory area (address zero)!")}}(function(){var f=new Int16Array(1),p=new Int8Array(f.buffer);if(f[0]=25459,p[0]!==115||p[1]!==99)throw"Runtime error: expected the system to be little-endian! (Run with -sSUPPORT_BIG_ENDIAN to bypass)"})();var Bi=[],kt=[],Ri=[],mi=!1;function Pi(){if(t.preRun)for(typeof t.preRun=="function"&&(t.preRun=[t.preRun]);t.preRun.length;)wt(t.preRun.shift());Ne(Bi)}function B(){O(!mi),mi=!0,At(),Ne(kt)}function Fi(){if(At(),t.postRun)for(typeof t.postRun=="function"&&(t.postRun=[t.postRun]);t.postRun.length;)Se(t.postRun.shift());Ne(Ri)}function wt(f){Bi.unshift(f)}function Ct(f){kt.unshift(f)}function Se(f){Ri.unshift(f)}O(Math.imul,"This browser does not support Math.imul(), build with LEGACY_VM_SUPPORT or POLYFILL_OLD_MATH_FUNCTIONS to add in a polyfill"),O(Math.fround,"This browser does not support Math.fround(), build with LEGACY_VM_SUPPORT or POLYFILL_OLD_MATH_FUNCTIONS to add in a polyfill"),O(Math.clz32,"This browser does not support Math.clz32(), build with LEGACY_VM_SUPPORT or POLYFILL_OLD_MATH_FUNCTIONS to add in a polyfill"),O(Math.trunc,"This browser does not support Math.trunc(), build with LEGACY_VM_SUPPORT or POLYFILL_OLD_MATH_FUNCTIONS to add in a polyfill");var Rt=0,Be=null,We=null,T={};function y(f){Rt++,t.monitorRunDependencies&&t.monitorRunDependencies(Rt),f?(O(!T[f]),T[f]=1,Be===null&&typeof setInterval<"u"&&(Be=setInterval(function(){if($){clearInterval(Be),Be=null;return}var p=!1;for(var E in T)p||(p=!0,P("still waiting on run dependencies:")),P("dependency: "+E);p&&P("(end of list)")},1e4))):P("warning: run dependency added without ID")}function k(f){if(Rt--,t.monitorRunDependencies&&t.monitorRunDependencies(Rt),f?(O(T[f]),delete T[f]):P("warning: run dependency removed without ID"),Rt==0&&(Be!==null&&(clearInterval(Be),Be=null),We)){var p=We;We=null,p()}}function oe(f){t.onAbort&&t.onAbort(f),f="Aborted("+f+")",P(f),$=!0,ne=1;var p=new WebAssembly.RuntimeError(f);throw r(p),p}var J={error:function(){oe("Filesystem support (FS) was not included. The problem is that you are using files from JS, but files were not used from C/C++, so filesystem support was not auto-included. You can force-include filesystem support with -sFORCE_FILESYSTEM")},init:function(){J.error()},createDataFile:function(){J.error()},createPreloadedFile:function(){J.error()},createLazyFile:function(){J.error()},open:function(){J.error()},mkdev:function(){J.error()},registerDevice:function(){J.error()},analyzePath:function(){J.error()},loadFilesFromDB:function(){J.error()},ErrnoError:function(){J.error()}};t.FS_createDataFile=J.createDataFile,t.FS_createPreloadedFile=J.createPreloadedFile;var me="data:application/octet-stream;base64,";function Me(f){return f.startsWith(me)}function j(f){return f.startsWith("file://")}function q(f,p){return function(){var E=f,D=p;return p||(D=t.asm),O(mi,"native function `"+E+"` called before runtime initialization"),D[f]||O(D[f],"exported native function `"+E+"` not found"),D[f].apply(null,arguments)}}var ce;ce="laz-perf.wasm",Me(ce)||(ce=M(ce));function F(f){try{if(f==ce&&W)return new Uint8Array(W);if(m)return m(f);throw"both async and sync fetching of the wasm failed"}catch(p){oe(p)}}function ie(){return!W&&(c||u)&&typeof fetch=="function"?fetch(ce,{credentials:"same-origin"}).then(function(f){if(!f.ok)throw"failed to load wasm binary file at '"+ce+"'";return f.arrayBuffer()}).catch(function(){return F(ce)}):Promise.resolve().then(function(){return F(ce)})}function Z(){var f={env:Ru,wasi_snapshot_preview1:Ru};function p(te,pe){var we=te.exports;t.asm=we,U=t.asm.memory,O(U,"memory not found in wasm exports"),yt(U.buffer),bt=t.asm.__indirect_function_table,O(bt,"table not found in wasm exports"),Ct(t.asm.__wasm_call_ctors),k("wasm-instantiate")}y("wasm-instantiate");var E=t;function D(te){O(t===E,"the Module object should not be replaced during async compilation - perhaps the order of HTML elements is wrong?"),E=null,p(te.instance)}function Y(te){return ie().then(function(pe){return WebAssembly.instantiate(pe,f)}).then(function(pe){return pe}).then(te,function(pe){P("failed to asynchronously prepare wasm: "+pe),j(ce)&&P("warning: Loading from a file URI ("+ce+") is not supported in most browsers. See https://emscripten.org/docs/getting_started/FAQ.html#how-do-i-run-a-local-webserver-for-testing-why-does-my-program-stall-in-downloading-or-preparing"),oe(pe)})}function se(){return!W&&typeof WebAssembly.instantiateStreaming=="function"&&!Me(ce)&&typeof fetch=="function"?fetch(ce,{credentials:"same-origin"}).then(function(te){var pe=WebAssembly.instantiateStreaming(te,f);return pe.then(D,function(we){return P("wasm streaming compile failed: "+we),P("falling back to ArrayBuffer instantiation"),Y(D)})}):Y(D)}if(t.instantiateWasm)try{var ae=t.instantiateWasm(f,p);return ae}catch(te){return P("Module.instantiateWasm callback failed with error: "+te),!1}return se().catch(r),{}}var ye,de;function ge(f){this.name="ExitStatus",this.message="Program terminated with exit("+f+")",this.status=f}function Ne(f){for(;f.length>0;)f.shift()(t)}function nt(f){return Xe("warning: build with -sDEMANGLE_SUPPORT to link in libcxxabi demangling"),f}function fe(f){var p=/\b_Z[\w\d_]+/g;return f.replace(p,function(E){var D=nt(E);return E===D?E:D+" ["+E+"]"})}function He(){var f=new Error;if(!f.stack){try{throw new Error}catch(p){f=p}if(!f.stack)return"(no stack trace available)"}return f.stack.toString()}function Xe(f){Xe.shown||(Xe.shown={}),Xe.shown[f]||(Xe.shown[f]=1,P(f))}function Te(f,p){O(f.length>=0,"writeArrayToMemory array must have a length (should be an array or typed array)"),_e.set(f,p)}function gt(f){return ic(f+24)+24}function Xt(f){this.excPtr=f,this.ptr=f-24,this.set_type=function(p){Ye[this.ptr+4>>2]=p},this.get_type=function(){return Ye[this.ptr+4>>2]},this.set_destructor=function(p){Ye[this.ptr+8>>2]=p},this.get_destructor=function(){return Ye[this.ptr+8>>2]},this.set_refcount=function(p){Fe[this.ptr>>2]=p},this.set_caught=function(p){p=p?1:0,_e[this.ptr+12>>0]=p},this.get_caught=function(){return _e[this.ptr+12>>0]!=0},this.set_rethrown=function(p){p=p?1:0,_e[this.ptr+13>>0]=p},this.get_rethrown=function(){return _e[this.ptr+13>>0]!=0},this.init=function(p,E){this.set_adjusted_ptr(0),this.set_type(p),this.set_destructor(E),this.set_refcount(0),this.set_caught(!1),this.set_rethrown(!1)},this.add_ref=function(){var p=Fe[this.ptr>>2];Fe[this.ptr>>2]=p+1},this.release_ref=function(){var p=Fe[this.ptr>>2];return Fe[this.ptr>>2]=p-1,O(p>0),p===1},this.set_adjusted_ptr=function(p){Ye[this.ptr+16>>2]=p},this.get_adjusted_ptr=function(){return Ye[this.ptr+16>>2]},this.get_exception_ptr=function(){var p=V_(this.get_type());if(p)return Ye[this.excPtr>>2];var E=this.get_adjusted_ptr();return E!==0?E:this.excPtr}}var pn=0,Wo=0;function Ls(f,p,E){var D=new Xt(f);throw D.init(p,E),pn=f,Wo++,f+" - Exception catching is disabled, this exception cannot be caught. Compile with -sNO_DISABLE_EXCEPTION_CATCHING or -sEXCEPTION_CATCHING_ALLOWED=[..] to catch."}function Yl(f,p,E,D,Y){}function Nr(f){switch(f){case 1:return 0;case 2:return 1;case 4:return 2;case 8:return 3;default:throw new TypeError("Unknown type size: "+f)}}function Xo(){for(var f=new Array(256),p=0;p<256;++p)f[p]=String.fromCharCode(p);mn=f}var mn=void 0;function gi(f){for(var p="",E=f;Ee[E];)p+=mn[Ee[E++]];return p}var Cn={},Pn={},Fn={},qo=48,Yo=57;function Wn(f){if(f===void 0)return"_unknown";f=f.replace(/[^a-zA-Z0-9_]/g,"$");var p=f.charCodeAt(0);return p>=qo&&p<=Yo?"_"+f:f}function $o(f,p){return f=Wn(f),function(){"use strict";return p.apply(this,arguments)}}function Br(f,p){var E=$o(p,function(D){this.name=p,this.message=D;var Y=new Error(D).stack;Y!==void 0&&(this.stack=this.toString()+`
`+Y.replace(/^Error(:[^\n]*)?\n/,""))});return E.prototype=Object.create(f.prototype),E.prototype.constructor=E,E.prototype.toString=function(){return this.message===void 0?this.name:this.name+": "+this.message},E}var Dn=void 0;function ut(f){throw new Dn(f)}var Ko=void 0;function Gr(f){throw new Ko(f)}function Xn(f,p,E){f.forEach(function(te){Fn[te]=p});function D(te){var pe=E(te);pe.length!==f.length&&Gr("Mismatched type converter count");for(var we=0;we<f.length;++we)v(f[we],pe[we])}var Y=new Array(p.length),se=[],ae=0;p.forEach((te,pe)=>{Pn.hasOwnProperty(te)?Y[pe]=Pn[te]:(se.push(te),Cn.hasOwnProperty(te)||(Cn[te]=[]),Cn[te].push(()=>{Y[pe]=Pn[te],++ae,ae===se.length&&D(Y)}))}),se.length===0&&D(Y)}function v(f,p,E={}){if(!("argPackAdvance"in p))throw new TypeError("registerType registeredInstance requires argPackAdvance");var D=p.name;if(f||ut('type "'+D+'" must have a positive integer typeid pointer'),Pn.hasOwnProperty(f)){if(E.ignoreDuplicateRegistrations)return;ut("Cannot register type '"+D+"' twice")}if(Pn[f]=p,delete Fn[f],Cn.hasOwnProperty(f)){var Y=Cn[f];delete Cn[f],Y.forEach(se=>se())}}function L(f,p,E,D,Y){var se=Nr(E);p=gi(p),v(f,{name:p,fromWireType:function(ae){return!!ae},toWireType:function(ae,te){return te?D:Y},argPackAdvance:8,readValueFromPointer:function(ae){var te;if(E===1)te=_e;else if(E===2)te=Ge;else if(E===4)te=Fe;else throw new TypeError("Unknown boolean type size: "+p);return this.fromWireType(te[ae>>se])},destructorFunction:null})}function X(f){if(!(this instanceof mt)||!(f instanceof mt))return!1;for(var p=this.$$.ptrType.registeredClass,E=this.$$.ptr,D=f.$$.ptrType.registeredClass,Y=f.$$.ptr;p.baseClass;)E=p.upcast(E),p=p.baseClass;for(;D.baseClass;)Y=D.upcast(Y),D=D.baseClass;return p===D&&E===Y}function z(f){return{count:f.count,deleteScheduled:f.deleteScheduled,preservePointerOnDelete:f.preservePointerOnDelete,ptr:f.ptr,ptrType:f.ptrType,smartPtr:f.smartPtr,smartPtrType:f.smartPtrType}}function H(f){function p(E){return E.$$.ptrType.registeredClass.name}ut(p(f)+" instance already deleted")}var xe=!1;function De(f){}function ve(f){f.smartPtr?f.smartPtrType.rawDestructor(f.smartPtr):f.ptrType.registeredClass.rawDestructor(f.ptr)}function Re(f){f.count.value-=1;var p=f.count.value===0;p&&ve(f)}function Ie(f,p,E){if(p===E)return f;if(E.baseClass===void 0)return null;var D=Ie(f,p,E.baseClass);return D===null?null:E.downcast(D)}var Je={};function at(){return Object.keys(Pe).length}function Le(){var f=[];for(var p in Pe)Pe.hasOwnProperty(p)&&f.push(Pe[p]);return f}var rt=[];function Dt(){for(;rt.length;){var f=rt.pop();f.$$.deleteScheduled=!1,f.delete()}}var pt=void 0;function St(f){pt=f,rt.length&&pt&&pt(Dt)}function Qt(){t.getInheritedInstanceCount=at,t.getLiveInheritedInstances=Le,t.flushPendingDeletes=Dt,t.setDelayFunction=St}var Pe={};function ci(f,p){for(p===void 0&&ut("ptr should not be undefined");f.baseClass;)p=f.upcast(p),f=f.baseClass;return p}function ft(f,p){return p=ci(f,p),Pe[p]}function Zi(f,p){(!p.ptrType||!p.ptr)&&Gr("makeClassHandle requires ptr and ptrType");var E=!!p.smartPtrType,D=!!p.smartPtr;return E!==D&&Gr("Both smartPtrType and smartPtr must be specified"),p.count={value:1},gn(Object.create(f,{$$:{value:p}}))}function Yt(f){var p=this.getPointee(f);if(!p)return this.destructor(f),null;var E=ft(this.registeredClass,p);if(E!==void 0){if(E.$$.count.value===0)return E.$$.ptr=p,E.$$.smartPtr=f,E.clone();var D=E.clone();return this.destructor(f),D}function Y(){return this.isSmartPointer?Zi(this.registeredClass.instancePrototype,{ptrType:this.pointeeType,ptr:p,smartPtrType:this,smartPtr:f}):Zi(this.registeredClass.instancePrototype,{ptrType:this,ptr:f})}var se=this.registeredClass.getActualType(p),ae=Je[se];if(!ae)return Y.call(this);var te;this.isConst?te=ae.constPointerType:te=ae.pointerType;var pe=Ie(p,this.registeredClass,te.registeredClass);return pe===null?Y.call(this):this.isSmartPointer?Zi(te.registeredClass.instancePrototype,{ptrType:te,ptr:pe,smartPtrType:this,smartPtr:f}):Zi(te.registeredClass.instancePrototype,{ptrType:te,ptr:pe})}function gn(f){return typeof FinalizationRegistry>"u"?(gn=p=>p,f):(xe=new FinalizationRegistry(p=>{console.warn(p.leakWarning.stack.replace(/^Error: /,"")),Re(p.$$)}),gn=p=>{var E=p.$$,D=!!E.smartPtr;if(D){var Y={$$:E},se=E.ptrType.registeredClass;Y.leakWarning=new Error("Embind found a leaked C++ instance "+se.name+" <0x"+E.ptr.toString(16)+`>.
We'll free it automatically in this case, but this functionality is not reliable across various environments.
Make sure to invoke .delete() manually once you're done with the instance instead.
Originally allocated`),"captureStackTrace"in Error&&Error.captureStackTrace(Y.leakWarning,Yt),xe.register(p,Y,p)}return p},De=p=>xe.unregister(p),gn(f))}function _n(){if(this.$$.ptr||H(this),this.$$.preservePointerOnDelete)return this.$$.count.value+=1,this;var f=gn(Object.create(Object.getPrototypeOf(this),{$$:{value:z(this.$$)}}));return f.$$.count.value+=1,f.$$.deleteScheduled=!1,f}function Ln(){this.$$.ptr||H(this),this.$$.deleteScheduled&&!this.$$.preservePointerOnDelete&&ut("Object already scheduled for deletion"),De(this),Re(this.$$),this.$$.preservePointerOnDelete||(this.$$.smartPtr=void 0,this.$$.ptr=void 0)}function ct(){return!this.$$.ptr}function $t(){return this.$$.ptr||H(this),this.$$.deleteScheduled&&!this.$$.preservePointerOnDelete&&ut("Object already scheduled for deletion"),rt.push(this),rt.length===1&&pt&&pt(Dt),this.$$.deleteScheduled=!0,this}function Gi(){mt.prototype.isAliasOf=X,mt.prototype.clone=_n,mt.prototype.delete=Ln,mt.prototype.isDeleted=ct,mt.prototype.deleteLater=$t}function mt(){}function Ht(f,p,E){if(f[p].overloadTable===void 0){var D=f[p];f[p]=function(){return f[p].overloadTable.hasOwnProperty(arguments.length)||ut("Function '"+E+"' called with an invalid number of arguments ("+arguments.length+") - expects one of ("+f[p].overloadTable+")!"),f[p].overloadTable[arguments.length].apply(this,arguments)},f[p].overloadTable=[],f[p].overloadTable[D.argCount]=D}}function an(f,p,E){t.hasOwnProperty(f)?((E===void 0||t[f].overloadTable!==void 0&&t[f].overloadTable[E]!==void 0)&&ut("Cannot register public name '"+f+"' twice"),Ht(t,f,f),t.hasOwnProperty(E)&&ut("Cannot register multiple overloads of a function with the same number of arguments ("+E+")!"),t[f].overloadTable[E]=p):(t[f]=p,E!==void 0&&(t[f].numArguments=E))}function Zo(f,p,E,D,Y,se,ae,te){this.name=f,this.constructor=p,this.instancePrototype=E,this.rawDestructor=D,this.baseClass=Y,this.getActualType=se,this.upcast=ae,this.downcast=te,this.pureVirtualFunctions=[]}function $l(f,p,E){for(;p!==E;)p.upcast||ut("Expected null or instance of "+E.name+", got an instance of "+p.name),f=p.upcast(f),p=p.baseClass;return f}function Og(f,p){if(p===null)return this.isReference&&ut("null is not a valid "+this.name),0;p.$$||ut('Cannot pass "'+kr(p)+'" as a '+this.name),p.$$.ptr||ut("Cannot pass deleted object as a pointer of type "+this.name);var E=p.$$.ptrType.registeredClass,D=$l(p.$$.ptr,E,this.registeredClass);return D}function Ng(f,p){var E;if(p===null)return this.isReference&&ut("null is not a valid "+this.name),this.isSmartPointer?(E=this.rawConstructor(),f!==null&&f.push(this.rawDestructor,E),E):0;p.$$||ut('Cannot pass "'+kr(p)+'" as a '+this.name),p.$$.ptr||ut("Cannot pass deleted object as a pointer of type "+this.name),!this.isConst&&p.$$.ptrType.isConst&&ut("Cannot convert argument of type "+(p.$$.smartPtrType?p.$$.smartPtrType.name:p.$$.ptrType.name)+" to parameter type "+this.name);var D=p.$$.ptrType.registeredClass;if(E=$l(p.$$.ptr,D,this.registeredClass),this.isSmartPointer)switch(p.$$.smartPtr===void 0&&ut("Passing raw pointer to smart pointer is illegal"),this.sharingPolicy){case 0:p.$$.smartPtrType===this?E=p.$$.smartPtr:ut("Cannot convert argument of type "+(p.$$.smartPtrType?p.$$.smartPtrType.name:p.$$.ptrType.name)+" to parameter type "+this.name);break;case 1:E=p.$$.smartPtr;break;case 2:if(p.$$.smartPtrType===this)E=p.$$.smartPtr;else{var Y=p.clone();E=this.rawShare(E,Jl.toHandle(function(){Y.delete()})),f!==null&&f.push(this.rawDestructor,E)}break;default:ut("Unsupporting sharing policy")}return E}function Bg(f,p){if(p===null)return this.isReference&&ut("null is not a valid "+this.name),0;p.$$||ut('Cannot pass "'+kr(p)+'" as a '+this.name),p.$$.ptr||ut("Cannot pass deleted object as a pointer of type "+this.name),p.$$.ptrType.isConst&&ut("Cannot convert argument of type "+p.$$.ptrType.name+" to parameter type "+this.name);var E=p.$$.ptrType.registeredClass,D=$l(p.$$.ptr,E,this.registeredClass);return D}function Jo(f){return this.fromWireType(Fe[f>>2])}function Gg(f){return this.rawGetPointee&&(f=this.rawGetPointee(f)),f}function zg(f){this.rawDestructor&&this.rawDestructor(f)}function kg(f){f!==null&&f.delete()}function Hg(){Un.prototype.getPointee=Gg,Un.prototype.destructor=zg,Un.prototype.argPackAdvance=8,Un.prototype.readValueFromPointer=Jo,Un.prototype.deleteObject=kg,Un.prototype.fromWireType=Yt}function Un(f,p,E,D,Y,se,ae,te,pe,we,qe){this.name=f,this.registeredClass=p,this.isReference=E,this.isConst=D,this.isSmartPointer=Y,this.pointeeType=se,this.sharingPolicy=ae,this.rawGetPointee=te,this.rawConstructor=pe,this.rawShare=we,this.rawDestructor=qe,!Y&&p.baseClass===void 0?D?(this.toWireType=Og,this.destructorFunction=null):(this.toWireType=Bg,this.destructorFunction=null):this.toWireType=Ng}function Vg(f,p,E){t.hasOwnProperty(f)||Gr("Replacing nonexistant public symbol"),t[f].overloadTable!==void 0&&E!==void 0?t[f].overloadTable[E]=p:(t[f]=p,t[f].argCount=E)}function Wg(f,p,E){O("dynCall_"+f in t,"bad function pointer type - no table for sig '"+f+"'"),E&&E.length?O(E.length===f.substring(1).replace(/j/g,"--").length):O(f.length==1);var D=t["dynCall_"+f];return E&&E.length?D.apply(null,[p].concat(E)):D.call(null,p)}var Us=[];function jo(f){var p=Us[f];return p||(f>=Us.length&&(Us.length=f+1),Us[f]=p=bt.get(f)),O(bt.get(f)==p,"JavaScript-side Wasm function table mirror is out of date!"),p}function Xg(f,p,E){if(f.includes("j"))return Wg(f,p,E);O(jo(p),"missing table entry in dynCall: "+p);var D=jo(p).apply(null,E);return D}function qg(f,p){O(f.includes("j")||f.includes("p"),"getDynCaller should only be called with i64 sigs");var E=[];return function(){return E.length=0,Object.assign(E,arguments),Xg(f,p,E)}}function zr(f,p){f=gi(f);function E(){return f.includes("j")?qg(f,p):jo(p)}var D=E();return typeof D!="function"&&ut("unknown function pointer with signature "+f+": "+p),D}var xu=void 0;function Yg(f){var p=N_(f),E=gi(p);return qn(p),E}function Kl(f,p){var E=[],D={};function Y(se){if(!D[se]&&!Pn[se]){if(Fn[se]){Fn[se].forEach(Y);return}E.push(se),D[se]=!0}}throw p.forEach(Y),new xu(f+": "+E.map(Yg).join([", "]))}function $g(f,p,E,D,Y,se,ae,te,pe,we,qe,et,Ke){qe=gi(qe),se=zr(Y,se),te&&(te=zr(ae,te)),we&&(we=zr(pe,we)),Ke=zr(et,Ke);var It=Wn(qe);an(It,function(){Kl("Cannot construct "+qe+" due to unbound types",[D])}),Xn([f,p,E],D?[D]:[],function(_t){_t=_t[0];var Pt,Di;D?(Pt=_t.registeredClass,Di=Pt.instancePrototype):Di=mt.prototype;var Mn=$o(It,function(){if(Object.getPrototypeOf(this)!==he)throw new Dn("Use 'new' to construct "+qe);if(ze.constructor_body===void 0)throw new Dn(qe+" has no accessible constructor");var ta=ze.constructor_body[arguments.length];if(ta===void 0)throw new Dn("Tried to invoke ctor of "+qe+" with invalid number of parameters ("+arguments.length+") - expected ("+Object.keys(ze.constructor_body).toString()+") parameters instead!");return ta.apply(this,arguments)}),he=Object.create(Di,{constructor:{value:Mn}});Mn.prototype=he;var ze=new Zo(qe,Mn,he,Ke,Pt,se,te,we),_i=new Un(qe,ze,!0,!1,!1),ui=new Un(qe+"*",ze,!1,!1,!1),pr=new Un(qe+" const*",ze,!1,!0,!1);return Je[f]={pointerType:ui,constPointerType:pr},Vg(It,Mn),[_i,ui,pr]})}function Mu(f,p){for(var E=[],D=0;D<f;D++)E.push(Ye[p+D*4>>2]);return E}function Kg(f){for(;f.length;){var p=f.pop(),E=f.pop();E(p)}}function yu(f,p,E,D,Y){var se=p.length;se<2&&ut("argTypes array size mismatch! Must at least get return value and 'this' types!");for(var ae=p[1]!==null&&E!==null,te=!1,pe=1;pe<p.length;++pe)if(p[pe]!==null&&p[pe].destructorFunction===void 0){te=!0;break}var we=p[0].name!=="void",qe=se-2,et=new Array(qe),Ke=[],It=[];return function(){arguments.length!==qe&&ut("function "+f+" called with "+arguments.length+" arguments, expected "+qe+" args!"),It.length=0;var _t;Ke.length=ae?2:1,Ke[0]=Y,ae&&(_t=p[1].toWireType(It,this),Ke[1]=_t);for(var Pt=0;Pt<qe;++Pt)et[Pt]=p[Pt+2].toWireType(It,arguments[Pt]),Ke.push(et[Pt]);var Di=D.apply(null,Ke);function Mn(he){if(te)Kg(It);else for(var ze=ae?1:2;ze<p.length;ze++){var _i=ze===1?_t:et[ze-2];p[ze].destructorFunction!==null&&p[ze].destructorFunction(_i)}if(we)return p[0].fromWireType(he)}return Mn(Di)}}function Zg(f,p,E,D,Y,se){O(p>0);var ae=Mu(p,E);Y=zr(D,Y),Xn([],[f],function(te){te=te[0];var pe="constructor "+te.name;if(te.registeredClass.constructor_body===void 0&&(te.registeredClass.constructor_body=[]),te.registeredClass.constructor_body[p-1]!==void 0)throw new Dn("Cannot register multiple constructors with identical number of parameters ("+(p-1)+") for class '"+te.name+"'! Overload resolution is currently only performed using the parameter count, not actual type info!");return te.registeredClass.constructor_body[p-1]=()=>{Kl("Cannot construct "+te.name+" due to unbound types",ae)},Xn([],ae,function(we){return we.splice(1,0,null),te.registeredClass.constructor_body[p-1]=yu(pe,we,null,Y,se),[]}),[]})}function Jg(f,p,E,D,Y,se,ae,te){var pe=Mu(E,D);p=gi(p),se=zr(Y,se),Xn([],[f],function(we){we=we[0];var qe=we.name+"."+p;p.startsWith("@@")&&(p=Symbol[p.substring(2)]),te&&we.registeredClass.pureVirtualFunctions.push(p);function et(){Kl("Cannot call "+qe+" due to unbound types",pe)}var Ke=we.registeredClass.instancePrototype,It=Ke[p];return It===void 0||It.overloadTable===void 0&&It.className!==we.name&&It.argCount===E-2?(et.argCount=E-2,et.className=we.name,Ke[p]=et):(Ht(Ke,p,qe),Ke[p].overloadTable[E-2]=et),Xn([],pe,function(_t){var Pt=yu(qe,_t,we,se,ae);return Ke[p].overloadTable===void 0?(Pt.argCount=E-2,Ke[p]=Pt):Ke[p].overloadTable[E-2]=Pt,[]}),[]})}var Zl=[],xn=[{},{value:void 0},{value:null},{value:!0},{value:!1}];function jg(f){f>4&&--xn[f].refcount===0&&(xn[f]=void 0,Zl.push(f))}function Qg(){for(var f=0,p=5;p<xn.length;++p)xn[p]!==void 0&&++f;return f}function e_(){for(var f=5;f<xn.length;++f)if(xn[f]!==void 0)return xn[f];return null}function t_(){t.count_emval_handles=Qg,t.get_first_emval=e_}var Jl={toValue:f=>(f||ut("Cannot use deleted val. handle = "+f),xn[f].value),toHandle:f=>{switch(f){case void 0:return 1;case null:return 2;case!0:return 3;case!1:return 4;default:{var p=Zl.length?Zl.pop():xn.length;return xn[p]={refcount:1,value:f},p}}}};function i_(f,p){p=gi(p),v(f,{name:p,fromWireType:function(E){var D=Jl.toValue(E);return jg(E),D},toWireType:function(E,D){return Jl.toHandle(D)},argPackAdvance:8,readValueFromPointer:Jo,destructorFunction:null})}function kr(f){if(f===null)return"null";var p=typeof f;return p==="object"||p==="array"||p==="function"?f.toString():""+f}function n_(f,p){switch(p){case 2:return function(E){return this.fromWireType(Ve[E>>2])};case 3:return function(E){return this.fromWireType(dt[E>>3])};default:throw new TypeError("Unknown float type: "+f)}}function r_(f,p,E){var D=Nr(E);p=gi(p),v(f,{name:p,fromWireType:function(Y){return Y},toWireType:function(Y,se){if(typeof se!="number"&&typeof se!="boolean")throw new TypeError('Cannot convert "'+kr(se)+'" to '+this.name);return se},argPackAdvance:8,readValueFromPointer:n_(p,D),destructorFunction:null})}function s_(f,p,E){switch(p){case 0:return E?function(Y){return _e[Y]}:function(Y){return Ee[Y]};case 1:return E?function(Y){return Ge[Y>>1]}:function(Y){return be[Y>>1]};case 2:return E?function(Y){return Fe[Y>>2]}:function(Y){return Ye[Y>>2]};default:throw new TypeError("Unknown integer type: "+f)}}function o_(f,p,E,D,Y){p=gi(p),Y===-1&&(Y=4294967295);var se=Nr(E),ae=et=>et;if(D===0){var te=32-8*E;ae=et=>et<<te>>>te}var pe=p.includes("unsigned"),we=(et,Ke)=>{if(typeof et!="number"&&typeof et!="boolean")throw new TypeError('Cannot convert "'+kr(et)+'" to '+Ke);if(et<D||et>Y)throw new TypeError('Passing a number "'+kr(et)+'" from JS side to C/C++ side to an argument of type "'+p+'", which is outside the valid range ['+D+", "+Y+"]!")},qe;pe?qe=function(et,Ke){return we(Ke,this.name),Ke>>>0}:qe=function(et,Ke){return we(Ke,this.name),Ke},v(f,{name:p,fromWireType:ae,toWireType:qe,argPackAdvance:8,readValueFromPointer:s_(p,se,D!==0),destructorFunction:null})}function a_(f,p,E){var D=[Int8Array,Uint8Array,Int16Array,Uint16Array,Int32Array,Uint32Array,Float32Array,Float64Array],Y=D[p];function se(ae){ae=ae>>2;var te=Ye,pe=te[ae],we=te[ae+1];return new Y(Q,we,pe)}E=gi(E),v(f,{name:E,fromWireType:se,argPackAdvance:8,readValueFromPointer:se},{ignoreDuplicateRegistrations:!0})}function l_(f,p){p=gi(p);var E=p==="std::string";v(f,{name:p,fromWireType:function(D){var Y=Ye[D>>2],se=D+4,ae;if(E)for(var te=se,pe=0;pe<=Y;++pe){var we=se+pe;if(pe==Y||Ee[we]==0){var qe=we-te,et=re(te,qe);ae===void 0?ae=et:(ae+="\0",ae+=et),te=we+1}}else{for(var Ke=new Array(Y),pe=0;pe<Y;++pe)Ke[pe]=String.fromCharCode(Ee[se+pe]);ae=Ke.join("")}return qn(D),ae},toWireType:function(D,Y){Y instanceof ArrayBuffer&&(Y=new Uint8Array(Y));var se,ae=typeof Y=="string";ae||Y instanceof Uint8Array||Y instanceof Uint8ClampedArray||Y instanceof Int8Array||ut("Cannot pass non-string to std::string"),E&&ae?se=Ze(Y):se=Y.length;var te=ic(4+se+1),pe=te+4;if(Ye[te>>2]=se,E&&ae)Ue(Y,pe,se+1);else if(ae)for(var we=0;we<se;++we){var qe=Y.charCodeAt(we);qe>255&&(qn(pe),ut("String has UTF-16 code units that do not fit in 8 bits")),Ee[pe+we]=qe}else for(var we=0;we<se;++we)Ee[pe+we]=Y[we];return D!==null&&D.push(qn,te),te},argPackAdvance:8,readValueFromPointer:Jo,destructorFunction:function(D){qn(D)}})}var vu=typeof TextDecoder<"u"?new TextDecoder("utf-16le"):void 0;function c_(f,p){O(f%2==0,"Pointer passed to UTF16ToString must be aligned to two bytes!");for(var E=f,D=E>>1,Y=D+p/2;!(D>=Y)&&be[D];)++D;if(E=D<<1,E-f>32&&vu)return vu.decode(Ee.subarray(f,E));for(var se="",ae=0;!(ae>=p/2);++ae){var te=Ge[f+ae*2>>1];if(te==0)break;se+=String.fromCharCode(te)}return se}function u_(f,p,E){if(O(p%2==0,"Pointer passed to stringToUTF16 must be aligned to two bytes!"),O(typeof E=="number","stringToUTF16(str, outPtr, maxBytesToWrite) is missing the third parameter that specifies the length of the output buffer!"),E===void 0&&(E=2147483647),E<2)return 0;E-=2;for(var D=p,Y=E<f.length*2?E/2:f.length,se=0;se<Y;++se){var ae=f.charCodeAt(se);Ge[p>>1]=ae,p+=2}return Ge[p>>1]=0,p-D}function f_(f){return f.length*2}function h_(f,p){O(f%4==0,"Pointer passed to UTF32ToString must be aligned to four bytes!");for(var E=0,D="";!(E>=p/4);){var Y=Fe[f+E*4>>2];if(Y==0)break;if(++E,Y>=65536){var se=Y-65536;D+=String.fromCharCode(55296|se>>10,56320|se&1023)}else D+=String.fromCharCode(Y)}return D}function d_(f,p,E){if(O(p%4==0,"Pointer passed to stringToUTF32 must be aligned to four bytes!"),O(typeof E=="number","stringToUTF32(str, outPtr, maxBytesToWrite) is missing the third parameter that specifies the length of the output buffer!"),E===void 0&&(E=2147483647),E<4)return 0;for(var D=p,Y=D+E-4,se=0;se<f.length;++se){var ae=f.charCodeAt(se);if(ae>=55296&&ae<=57343){var te=f.charCodeAt(++se);ae=65536+((ae&1023)<<10)|te&1023}if(Fe[p>>2]=ae,p+=4,p+4>Y)break}return Fe[p>>2]=0,p-D}function p_(f){for(var p=0,E=0;E<f.length;++E){var D=f.charCodeAt(E);D>=55296&&D<=57343&&++E,p+=4}return p}function m_(f,p,E){E=gi(E);var D,Y,se,ae,te;p===2?(D=c_,Y=u_,ae=f_,se=()=>be,te=1):p===4&&(D=h_,Y=d_,ae=p_,se=()=>Ye,te=2),v(f,{name:E,fromWireType:function(pe){for(var we=Ye[pe>>2],qe=se(),et,Ke=pe+4,It=0;It<=we;++It){var _t=pe+4+It*p;if(It==we||qe[_t>>te]==0){var Pt=_t-Ke,Di=D(Ke,Pt);et===void 0?et=Di:(et+="\0",et+=Di),Ke=_t+p}}return qn(pe),et},toWireType:function(pe,we){typeof we!="string"&&ut("Cannot pass non-string to C++ string type "+E);var qe=ae(we),et=ic(4+qe+p);return Ye[et>>2]=qe>>te,Y(we,et+4,qe+p),pe!==null&&pe.push(qn,et),et},argPackAdvance:8,readValueFromPointer:Jo,destructorFunction:function(pe){qn(pe)}})}function g_(f,p){p=gi(p),v(f,{isVoid:!0,name:p,argPackAdvance:0,fromWireType:function(){},toWireType:function(E,D){}})}function __(){oe("native code called abort()")}function x_(f,p,E){Ee.copyWithin(f,p,p+E)}function M_(){return 2147483648}function y_(f){try{return U.grow(f-Q.byteLength+65535>>>16),yt(U.buffer),1}catch(p){P("emscripten_realloc_buffer: Attempted to grow heap from "+Q.byteLength+" bytes to "+f+" bytes, but got error: "+p)}}function v_(f){var p=Ee.length;f=f>>>0,O(f>p);var E=M_();if(f>E)return P("Cannot enlarge memory, asked to go up to "+f+" bytes, but the limit is "+E+" bytes!"),!1;let D=(pe,we)=>pe+(we-pe%we)%we;for(var Y=1;Y<=4;Y*=2){var se=p*(1+.2/Y);se=Math.min(se,f+100663296);var ae=Math.min(E,D(Math.max(f,se),65536)),te=y_(ae);if(te)return!0}return P("Failed to grow the heap from "+p+" bytes to "+ae+" bytes, not enough memory!"),!1}var jl={};function S_(){return a||"./this.program"}function Is(){if(!Is.strings){var f=(typeof navigator=="object"&&navigator.languages&&navigator.languages[0]||"C").replace("-","_")+".UTF-8",p={USER:"web_user",LOGNAME:"web_user",PATH:"/",PWD:"/",HOME:"/home/web_user",LANG:f,_:S_()};for(var E in jl)jl[E]===void 0?delete p[E]:p[E]=jl[E];var D=[];for(var E in p)D.push(E+"="+p[E]);Is.strings=D}return Is.strings}function E_(f,p,E){for(var D=0;D<f.length;++D)O(f.charCodeAt(D)===(f.charCodeAt(D)&255)),_e[p++>>0]=f.charCodeAt(D);E||(_e[p>>0]=0)}var Ql={varargs:void 0,get:function(){O(Ql.varargs!=null),Ql.varargs+=4;var f=Fe[Ql.varargs-4>>2];return f},getStr:function(f){var p=re(f);return p}};function b_(f,p){var E=0;return Is().forEach(function(D,Y){var se=p+E;Ye[f+Y*4>>2]=se,E_(D,se),E+=D.length+1}),0}function T_(f,p){var E=Is();Ye[f>>2]=E.length;var D=0;return E.forEach(function(Y){D+=Y.length+1}),Ye[p>>2]=D,0}function A_(f){oe("fd_close called without SYSCALLS_REQUIRE_FILESYSTEM")}function R_(f,p,E,D,Y){return 70}var ec=[null,[],[]];function tc(f,p){var E=ec[f];O(E),p===0||p===10?((f===1?R:P)(K(E,0)),E.length=0):E.push(p)}function Uv(){B_(0),ec[1].length&&tc(1,10),ec[2].length&&tc(2,10)}function w_(f,p,E,D){for(var Y=0,se=0;se<E;se++){var ae=Ye[p>>2],te=Ye[p+4>>2];p+=8;for(var pe=0;pe<te;pe++)tc(f,Ee[ae+pe]);Y+=te}return Ye[D>>2]=Y,0}function Qo(f){return f%4===0&&(f%100!==0||f%400===0)}function C_(f,p){for(var E=0,D=0;D<=p;E+=f[D++]);return E}var Su=[31,29,31,30,31,30,31,31,30,31,30,31],Eu=[31,28,31,30,31,30,31,31,30,31,30,31];function P_(f,p){for(var E=new Date(f.getTime());p>0;){var D=Qo(E.getFullYear()),Y=E.getMonth(),se=(D?Su:Eu)[Y];if(p>se-E.getDate())p-=se-E.getDate()+1,E.setDate(1),Y<11?E.setMonth(Y+1):(E.setMonth(0),E.setFullYear(E.getFullYear()+1));else return E.setDate(E.getDate()+p),E}return E}function F_(f,p,E){var D=E>0?E:Ze(f)+1,Y=new Array(D),se=le(f,Y,0,Y.length);return p&&(Y.length=se),Y}function D_(f,p,E,D){var Y=Fe[D+40>>2],se={tm_sec:Fe[D>>2],tm_min:Fe[D+4>>2],tm_hour:Fe[D+8>>2],tm_mday:Fe[D+12>>2],tm_mon:Fe[D+16>>2],tm_year:Fe[D+20>>2],tm_wday:Fe[D+24>>2],tm_yday:Fe[D+28>>2],tm_isdst:Fe[D+32>>2],tm_gmtoff:Fe[D+36>>2],tm_zone:Y?re(Y):""},ae=re(E),te={"%c":"%a %b %d %H:%M:%S %Y","%D":"%m/%d/%y","%F":"%Y-%m-%d","%h":"%b","%r":"%I:%M:%S %p","%R":"%H:%M","%T":"%H:%M:%S","%x":"%m/%d/%y","%X":"%H:%M:%S","%Ec":"%c","%EC":"%C","%Ex":"%m/%d/%y","%EX":"%H:%M:%S","%Ey":"%y","%EY":"%Y","%Od":"%d","%Oe":"%e","%OH":"%H","%OI":"%I","%Om":"%m","%OM":"%M","%OS":"%S","%Ou":"%u","%OU":"%U","%OV":"%V","%Ow":"%w","%OW":"%W","%Oy":"%y"};for(var pe in te)ae=ae.replace(new RegExp(pe,"g"),te[pe]);var we=["Sunday","Monday","Tuesday","Wednesday","Thursday","Friday","Saturday"],qe=["January","February","March","April","May","June","July","August","September","October","November","December"];function et(he,ze,_i){for(var ui=typeof he=="number"?he.toString():he||"";ui.length<ze;)ui=_i[0]+ui;return ui}function Ke(he,ze){return et(he,ze,"0")}function It(he,ze){function _i(pr){return pr<0?-1:pr>0?1:0}var ui;return(ui=_i(he.getFullYear()-ze.getFullYear()))===0&&(ui=_i(he.getMonth()-ze.getMonth()))===0&&(ui=_i(he.getDate()-ze.getDate())),ui}function _t(he){switch(he.getDay()){case 0:return new Date(he.getFullYear()-1,11,29);case 1:return he;case 2:return new Date(he.getFullYear(),0,3);case 3:return new Date(he.getFullYear(),0,2);case 4:return new Date(he.getFullYear(),0,1);case 5:return new Date(he.getFullYear()-1,11,31);case 6:return new Date(he.getFullYear()-1,11,30)}}function Pt(he){var ze=P_(new Date(he.tm_year+1900,0,1),he.tm_yday),_i=new Date(ze.getFullYear(),0,4),ui=new Date(ze.getFullYear()+1,0,4),pr=_t(_i),ta=_t(ui);return It(pr,ze)<=0?It(ta,ze)<=0?ze.getFullYear()+1:ze.getFullYear():ze.getFullYear()-1}var Di={"%a":function(he){return we[he.tm_wday].substring(0,3)},"%A":function(he){return we[he.tm_wday]},"%b":function(he){return qe[he.tm_mon].substring(0,3)},"%B":function(he){return qe[he.tm_mon]},"%C":function(he){var ze=he.tm_year+1900;return Ke(ze/100|0,2)},"%d":function(he){return Ke(he.tm_mday,2)},"%e":function(he){return et(he.tm_mday,2," ")},"%g":function(he){return Pt(he).toString().substring(2)},"%G":function(he){return Pt(he)},"%H":function(he){return Ke(he.tm_hour,2)},"%I":function(he){var ze=he.tm_hour;return ze==0?ze=12:ze>12&&(ze-=12),Ke(ze,2)},"%j":function(he){return Ke(he.tm_mday+C_(Qo(he.tm_year+1900)?Su:Eu,he.tm_mon-1),3)},"%m":function(he){return Ke(he.tm_mon+1,2)},"%M":function(he){return Ke(he.tm_min,2)},"%n":function(){return`
`},"%p":function(he){return he.tm_hour>=0&&he.tm_hour<12?"AM":"PM"},"%S":function(he){return Ke(he.tm_sec,2)},"%t":function(){return"	"},"%u":function(he){return he.tm_wday||7},"%U":function(he){var ze=he.tm_yday+7-he.tm_wday;return Ke(Math.floor(ze/7),2)},"%V":function(he){var ze=Math.floor((he.tm_yday+7-(he.tm_wday+6)%7)/7);if((he.tm_wday+371-he.tm_yday-2)%7<=2&&ze++,ze){if(ze==53){var ui=(he.tm_wday+371-he.tm_yday)%7;ui!=4&&(ui!=3||!Qo(he.tm_year))&&(ze=1)}}else{ze=52;var _i=(he.tm_wday+7-he.tm_yday-1)%7;(_i==4||_i==5&&Qo(he.tm_year%400-1))&&ze++}return Ke(ze,2)},"%w":function(he){return he.tm_wday},"%W":function(he){var ze=he.tm_yday+7-(he.tm_wday+6)%7;return Ke(Math.floor(ze/7),2)},"%y":function(he){return(he.tm_year+1900).toString().substring(2)},"%Y":function(he){return he.tm_year+1900},"%z":function(he){var ze=he.tm_gmtoff,_i=ze>=0;return ze=Math.abs(ze)/60,ze=ze/60*100+ze%60,(_i?"+":"-")+("0000"+ze).slice(-4)},"%Z":function(he){return he.tm_zone},"%%":function(){return"%"}};ae=ae.replace(/%%/g,"\0\0");for(var pe in Di)ae.includes(pe)&&(ae=ae.replace(new RegExp(pe,"g"),Di[pe](se)));ae=ae.replace(/\0\0/g,"%");var Mn=F_(ae,!1);return Mn.length>p?0:(Te(Mn,f),Mn.length-1)}function L_(f,p,E,D){return D_(f,p,E,D)}function bu(f,p){O(f<16384),f<128?p.push(f):p.push(f%128|128,f>>7)}function U_(f){for(var p={i:"i32",j:"i64",f:"f32",d:"f64",p:"i32"},E={parameters:[],results:f[0]=="v"?[]:[p[f[0]]]},D=1;D<f.length;++D)O(f[D]in p,"invalid signature char: "+f[D]),E.parameters.push(p[f[D]]);return E}function Iv(f,p){if(typeof WebAssembly.Function=="function")return new WebAssembly.Function(U_(p),f);var E=[1,96],D=p.slice(0,1),Y=p.slice(1),se={i:127,p:127,j:126,f:125,d:124};bu(Y.length,E);for(var ae=0;ae<Y.length;++ae)O(Y[ae]in se,"invalid signature char: "+Y[ae]),E.push(se[Y[ae]]);D=="v"?E.push(0):E.push(1,se[D]);var te=[0,97,115,109,1,0,0,0,1];bu(E.length,te),te.push.apply(te,E),te.push(2,7,1,1,101,1,102,0,0,7,5,1,1,102,0,0);var pe=new WebAssembly.Module(new Uint8Array(te)),we=new WebAssembly.Instance(pe,{e:{f}}),qe=we.exports.f;return qe}function Ov(f,p){if(Tu)for(var E=f;E<f+p;E++){var D=jo(E);D&&Tu.set(D,E)}}var Tu=void 0,Au=[];function Nv(){if(Au.length)return Au.pop();try{bt.grow(1)}catch(f){throw f instanceof RangeError?"Unable to grow wasm table. Set ALLOW_TABLE_GROWTH.":f}return bt.length-1}function Bv(f,p){bt.set(f,p),Us[f]=bt.get(f)}var Gv=1;function I_(f){var p=t["_"+f];return O(p,"Cannot call unknown function "+f+", make sure it is exported"),p}function zv(f,p,E,D,Y){var se={string:_t=>{var Pt=0;if(_t!=null&&_t!==0){var Di=(_t.length<<2)+1;Pt=Cu(Di),Ue(_t,Pt,Di)}return Pt},array:_t=>{var Pt=Cu(_t.length);return Te(_t,Pt),Pt}};function ae(_t){return p==="string"?re(_t):p==="boolean"?!!_t:_t}var te=I_(f),pe=[],we=0;if(O(p!=="array",'Return type should not be "array".'),D)for(var qe=0;qe<D.length;qe++){var et=se[E[qe]];et?(we===0&&(we=k_()),pe[qe]=et(D[qe])):pe[qe]=D[qe]}var Ke=te.apply(null,pe);function It(_t){return we!==0&&H_(we),ae(_t)}return Ke=It(Ke),Ke}Xo(),Dn=t.BindingError=Br(Error,"BindingError"),Ko=t.InternalError=Br(Error,"InternalError"),Gi(),Qt(),Hg(),xu=t.UnboundTypeError=Br(Error,"UnboundTypeError"),t_();var kv=!0;function O_(){A("fetchSettings")}var Ru={__cxa_allocate_exception:gt,__cxa_throw:Ls,_embind_register_bigint:Yl,_embind_register_bool:L,_embind_register_class:$g,_embind_register_class_constructor:Zg,_embind_register_class_function:Jg,_embind_register_emval:i_,_embind_register_float:r_,_embind_register_integer:o_,_embind_register_memory_view:a_,_embind_register_std_string:l_,_embind_register_std_wstring:m_,_embind_register_void:g_,abort:__,emscripten_memcpy_big:x_,emscripten_resize_heap:v_,environ_get:b_,environ_sizes_get:T_,fd_close:A_,fd_seek:R_,fd_write:w_,strftime_l:L_},Hv=Z(),Vv=t.___wasm_call_ctors=q("__wasm_call_ctors"),ic=t._malloc=q("malloc"),qn=t._free=q("free"),N_=t.___getTypeName=q("__getTypeName"),Wv=t.__embind_initialize_bindings=q("_embind_initialize_bindings"),Xv=t.___errno_location=q("__errno_location"),B_=t._fflush=q("fflush"),wu=t._emscripten_stack_init=function(){return(wu=t._emscripten_stack_init=t.asm.emscripten_stack_init).apply(null,arguments)},G_=t._emscripten_stack_get_free=function(){return(G_=t._emscripten_stack_get_free=t.asm.emscripten_stack_get_free).apply(null,arguments)},z_=t._emscripten_stack_get_base=function(){return(z_=t._emscripten_stack_get_base=t.asm.emscripten_stack_get_base).apply(null,arguments)},nc=t._emscripten_stack_get_end=function(){return(nc=t._emscripten_stack_get_end=t.asm.emscripten_stack_get_end).apply(null,arguments)},k_=t.stackSave=q("stackSave"),H_=t.stackRestore=q("stackRestore"),Cu=t.stackAlloc=q("stackAlloc"),V_=t.___cxa_is_pointer_type=q("__cxa_is_pointer_type"),qv=t.dynCall_viijii=q("dynCall_viijii"),Yv=t.dynCall_ji=q("dynCall_ji"),$v=t.dynCall_jiji=q("dynCall_jiji"),Kv=t.dynCall_iiiiij=q("dynCall_iiiiij"),Zv=t.dynCall_iiiiijj=q("dynCall_iiiiijj"),Jv=t.dynCall_iiiiiijj=q("dynCall_iiiiiijj"),W_=["run","UTF8ArrayToString","UTF8ToString","stringToUTF8Array","stringToUTF8","lengthBytesUTF8","addOnPreRun","addOnInit","addOnPreMain","addOnExit","addOnPostRun","addRunDependency","removeRunDependency","FS_createFolder","FS_createPath","FS_createDataFile","FS_createPreloadedFile","FS_createLazyFile","FS_createLink","FS_createDevice","FS_unlink","getLEB","getFunctionTables","alignFunctionTables","registerFunctions","prettyPrint","getCompilerSetting","print","printErr","callMain","abort","keepRuntimeAlive","wasmMemory","stackAlloc","stackSave","stackRestore","getTempRet0","setTempRet0","writeStackCookie","checkStackCookie","ptrToString","zeroMemory","stringToNewUTF8","exitJS","getHeapMax","emscripten_realloc_buffer","ENV","ERRNO_CODES","ERRNO_MESSAGES","setErrNo","inetPton4","inetNtop4","inetPton6","inetNtop6","readSockaddr","writeSockaddr","DNS","getHostByName","Protocols","Sockets","getRandomDevice","warnOnce","traverseStack","UNWIND_CACHE","convertPCtoSourceLocation","readAsmConstArgsArray","readAsmConstArgs","mainThreadEM_ASM","jstoi_q","jstoi_s","getExecutableName","listenOnce","autoResumeAudioContext","dynCallLegacy","getDynCaller","dynCall","handleException","runtimeKeepalivePush","runtimeKeepalivePop","callUserCallback","maybeExit","safeSetTimeout","asmjsMangle","asyncLoad","alignMemory","mmapAlloc","writeI53ToI64","writeI53ToI64Clamped","writeI53ToI64Signaling","writeI53ToU64Clamped","writeI53ToU64Signaling","readI53FromI64","readI53FromU64","convertI32PairToI53","convertI32PairToI53Checked","convertU32PairToI53","getCFunc","ccall","cwrap","uleb128Encode","sigToWasmTypes","convertJsFunctionToWasm","freeTableIndexes","functionsInTableMap","getEmptyTableSlot","updateTableMap","addFunction","removeFunction","reallyNegative","unSign","strLen","reSign","formatString","setValue","getValue","PATH","PATH_FS","intArrayFromString","intArrayToString","AsciiToString","stringToAscii","UTF16Decoder","UTF16ToString","stringToUTF16","lengthBytesUTF16","UTF32ToString","stringToUTF32","lengthBytesUTF32","allocateUTF8","allocateUTF8OnStack","writeStringToMemory","writeArrayToMemory","writeAsciiToMemory","SYSCALLS","getSocketFromFD","getSocketAddress","JSEvents","registerKeyEventCallback","specialHTMLTargets","maybeCStringToJsString","findEventTarget","findCanvasEventTarget","getBoundingClientRect","fillMouseEventData","registerMouseEventCallback","registerWheelEventCallback","registerUiEventCallback","registerFocusEventCallback","fillDeviceOrientationEventData","registerDeviceOrientationEventCallback","fillDeviceMotionEventData","registerDeviceMotionEventCallback","screenOrientation","fillOrientationChangeEventData","registerOrientationChangeEventCallback","fillFullscreenChangeEventData","registerFullscreenChangeEventCallback","JSEvents_requestFullscreen","JSEvents_resizeCanvasForFullscreen","registerRestoreOldStyle","hideEverythingExceptGivenElement","restoreHiddenElements","setLetterbox","currentFullscreenStrategy","restoreOldWindowedStyle","softFullscreenResizeWebGLRenderTarget","doRequestFullscreen","fillPointerlockChangeEventData","registerPointerlockChangeEventCallback","registerPointerlockErrorEventCallback","requestPointerLock","fillVisibilityChangeEventData","registerVisibilityChangeEventCallback","registerTouchEventCallback","fillGamepadEventData","registerGamepadEventCallback","registerBeforeUnloadEventCallback","fillBatteryEventData","battery","registerBatteryEventCallback","setCanvasElementSize","getCanvasElementSize","demangle","demangleAll","jsStackTrace","stackTrace","ExitStatus","getEnvStrings","checkWasiClock","flush_NO_FILESYSTEM","dlopenMissingError","setImmediateWrapped","clearImmediateWrapped","polyfillSetImmediate","uncaughtExceptionCount","exceptionLast","exceptionCaught","ExceptionInfo","exception_addRef","exception_decRef","Browser","setMainLoop","wget","FS","MEMFS","TTY","PIPEFS","SOCKFS","_setNetworkCallback","tempFixedLengthArray","miniTempWebGLFloatBuffers","heapObjectForWebGLType","heapAccessShiftForWebGLHeap","GL","emscriptenWebGLGet","computeUnpackAlignedImageSize","emscriptenWebGLGetTexPixelData","emscriptenWebGLGetUniform","webglGetUniformLocation","webglPrepareUniformLocationsBeforeFirstUse","webglGetLeftBracePos","emscriptenWebGLGetVertexAttrib","writeGLArray","AL","SDL_unicode","SDL_ttfContext","SDL_audio","SDL","SDL_gfx","GLUT","EGL","GLFW_Window","GLFW","GLEW","IDBStore","runAndAbortIfError","ALLOC_NORMAL","ALLOC_STACK","allocate","InternalError","BindingError","UnboundTypeError","PureVirtualError","init_embind","throwInternalError","throwBindingError","throwUnboundTypeError","ensureOverloadTable","exposePublicSymbol","replacePublicSymbol","extendError","createNamedFunction","embindRepr","registeredInstances","getBasestPointer","registerInheritedInstance","unregisterInheritedInstance","getInheritedInstance","getInheritedInstanceCount","getLiveInheritedInstances","registeredTypes","awaitingDependencies","typeDependencies","registeredPointers","registerType","whenDependentTypesAreResolved","embind_charCodes","embind_init_charCodes","readLatin1String","getTypeName","heap32VectorToArray","requireRegisteredType","getShiftFromSize","integerReadValueFromPointer","enumReadValueFromPointer","floatReadValueFromPointer","simpleReadValueFromPointer","runDestructors","new_","craftInvokerFunction","embind__requireFunction","tupleRegistrations","structRegistrations","genericPointerToWireType","constNoSmartPtrRawPointerToWireType","nonConstNoSmartPtrRawPointerToWireType","init_RegisteredPointer","RegisteredPointer","RegisteredPointer_getPointee","RegisteredPointer_destructor","RegisteredPointer_deleteObject","RegisteredPointer_fromWireType","runDestructor","releaseClassHandle","finalizationRegistry","detachFinalizer_deps","detachFinalizer","attachFinalizer","makeClassHandle","init_ClassHandle","ClassHandle","ClassHandle_isAliasOf","throwInstanceAlreadyDeleted","ClassHandle_clone","ClassHandle_delete","deletionQueue","ClassHandle_isDeleted","ClassHandle_deleteLater","flushPendingDeletes","delayFunction","setDelayFunction","RegisteredClass","shallowCopyInternalPointer","downcastPointer","upcastPointer","validateThis","char_0","char_9","makeLegalFunctionName","emval_handle_array","emval_free_list","emval_symbols","init_emval","count_emval_handles","get_first_emval","getStringOrSymbol","Emval","emval_newers","craftEmvalAllocator","emval_get_global","emval_lookupTypes","emval_allocateDestructors","emval_methodCallers","emval_addMethodCaller","emval_registeredMethods"];W_.forEach(G);var X_=["ptrToString","zeroMemory","stringToNewUTF8","exitJS","setErrNo","inetPton4","inetNtop4","inetPton6","inetNtop6","readSockaddr","writeSockaddr","getHostByName","getRandomDevice","traverseStack","convertPCtoSourceLocation","readAsmConstArgs","mainThreadEM_ASM","jstoi_q","jstoi_s","listenOnce","autoResumeAudioContext","runtimeKeepalivePush","runtimeKeepalivePop","callUserCallback","maybeExit","safeSetTimeout","asmjsMangle","asyncLoad","alignMemory","mmapAlloc","writeI53ToI64","writeI53ToI64Clamped","writeI53ToI64Signaling","writeI53ToU64Clamped","writeI53ToU64Signaling","readI53FromI64","readI53FromU64","convertI32PairToI53","convertU32PairToI53","reallyNegative","unSign","strLen","reSign","formatString","getSocketFromFD","getSocketAddress","registerKeyEventCallback","maybeCStringToJsString","findEventTarget","findCanvasEventTarget","getBoundingClientRect","fillMouseEventData","registerMouseEventCallback","registerWheelEventCallback","registerUiEventCallback","registerFocusEventCallback","fillDeviceOrientationEventData","registerDeviceOrientationEventCallback","fillDeviceMotionEventData","registerDeviceMotionEventCallback","screenOrientation","fillOrientationChangeEventData","registerOrientationChangeEventCallback","fillFullscreenChangeEventData","registerFullscreenChangeEventCallback","JSEvents_requestFullscreen","JSEvents_resizeCanvasForFullscreen","registerRestoreOldStyle","hideEverythingExceptGivenElement","restoreHiddenElements","setLetterbox","softFullscreenResizeWebGLRenderTarget","doRequestFullscreen","fillPointerlockChangeEventData","registerPointerlockChangeEventCallback","registerPointerlockErrorEventCallback","requestPointerLock","fillVisibilityChangeEventData","registerVisibilityChangeEventCallback","registerTouchEventCallback","fillGamepadEventData","registerGamepadEventCallback","registerBeforeUnloadEventCallback","fillBatteryEventData","battery","registerBatteryEventCallback","setCanvasElementSize","getCanvasElementSize","checkWasiClock","setImmediateWrapped","clearImmediateWrapped","polyfillSetImmediate","exception_addRef","exception_decRef","setMainLoop","_setNetworkCallback","heapObjectForWebGLType","heapAccessShiftForWebGLHeap","emscriptenWebGLGet","computeUnpackAlignedImageSize","emscriptenWebGLGetTexPixelData","emscriptenWebGLGetUniform","webglGetUniformLocation","webglPrepareUniformLocationsBeforeFirstUse","webglGetLeftBracePos","emscriptenWebGLGetVertexAttrib","writeGLArray","SDL_unicode","SDL_ttfContext","SDL_audio","GLFW_Window","runAndAbortIfError","registerInheritedInstance","unregisterInheritedInstance","requireRegisteredType","enumReadValueFromPointer","validateThis","getStringOrSymbol","craftEmvalAllocator","emval_get_global","emval_lookupTypes","emval_allocateDestructors","emval_addMethodCaller"];X_.forEach(N);var ea;We=function f(){ea||Pu(),ea||(We=f)};function q_(){wu(),pi()}function Pu(f){if(f=f||o,Rt>0||(q_(),Pi(),Rt>0))return;function p(){ea||(ea=!0,t.calledRun=!0,!$&&(B(),n(t),t.onRuntimeInitialized&&t.onRuntimeInitialized(),O(!t._main,'compiled without a main, but one is present. if you added it from JS, use Module["onRuntimeInitialized"]'),Fi()))}t.setStatus?(t.setStatus("Running..."),setTimeout(function(){setTimeout(function(){t.setStatus("")},1),p()},1)):p(),At()}if(t.preInit)for(typeof t.preInit=="function"&&(t.preInit=[t.preInit]);t.preInit.length>0;)t.preInit.pop()();return Pu(),e.ready})})();typeof Nl=="object"&&typeof lu=="object"?lu.exports=au:typeof define=="function"&&define.amd?define([],function(){return au}):typeof Nl=="object"&&(Nl.createLazPerf=au)});var uu=xt(An=>{"use strict";var Ny=An&&An.__importDefault||function(i){return i&&i.__esModule?i:{default:i}};Object.defineProperty(An,"__esModule",{value:!0});An.LazPerf=An.create=An.createLazPerf=void 0;var cu=Ny(ng());An.createLazPerf=cu.default;An.create=cu.default;An.LazPerf={create:cu.default}});var lg=xt(dr=>{"use strict";Object.defineProperty(dr,"__esModule",{value:!0});dr.decompressFile=dr.decompressChunk=dr.PointData=void 0;var rg=uu(),By=ou();dr.PointData={createLazPerf:rg.createLazPerf,decompressChunk:og,decompressFile:ag};var fu;async function sg(i){return i||(fu||(fu=(0,rg.createLazPerf)()),fu)}async function og(i,{pointCount:e,pointDataRecordFormat:t,pointDataRecordLength:n},r){let s=await sg(r),o=new Uint8Array(e*n),a=s._malloc(i.byteLength),l=s._malloc(n),c=new s.ChunkDecoder;try{s.HEAPU8.set(new Uint8Array(i.buffer,i.byteOffset,i.byteLength),a),c.open(t,n,a);for(let u=0;u<e;++u)c.getPoint(l),o.set(new Uint8Array(s.HEAPU8.buffer,l,n),u*n)}finally{s._free(a),s._free(l),c.delete()}return o}dr.decompressChunk=og;async function ag(i,e){let t=await sg(e),n=By.Header.parse(i),{pointCount:r,pointDataRecordLength:s}=n,o=new Uint8Array(r*s),a=t._malloc(i.byteLength),l=t._malloc(s),c=new t.LASZip;try{t.HEAPU8.set(new Uint8Array(i.buffer,i.byteOffset,i.byteLength),a),c.open(a,i.byteLength);for(let u=0;u<r;++u)c.getPoint(l),o.set(new Uint8Array(t.HEAPU8.buffer,l,s),u*s)}finally{c.delete()}return o}dr.decompressFile=ag});var cg=xt(Bl=>{"use strict";Object.defineProperty(Bl,"__esModule",{value:!0});Bl.View=void 0;var Gy=sn(),zy=nu(),ky=ru();Bl.View={create:Hy};function Hy(i,e,t=[],n){let r=ky.Extractor.create(e,t);if(n){let u=new Set([...n]);r=Object.entries(r).reduce((h,[d,g])=>(u.has(d)&&(h[d]=g),h),{})}let s=zy.Dimensions.create(r,t),o=Gy.Binary.toDataView(i),a=e.pointDataRecordLength;if(o.byteLength%a!==0)throw new Error(`Invalid buffer length (${o.byteLength}) for point length ${a}`);let l=o.byteLength/e.pointDataRecordLength;function c(u){let h=r[u];if(!h)throw new Error(`No extractor for dimension: ${u}`);return function(d){if(d>=l)throw new RangeError(`View index (${d}) out of range: ${l}`);return h(o,d)}}return{pointCount:l,dimensions:s,getter:c}}});var dg=xt(Gl=>{"use strict";Object.defineProperty(Gl,"__esModule",{value:!0});Gl.Vlr=void 0;var Rn=sn(),Fs=Al();Gl.Vlr={walk:Xy,parse:hg,find:fg,at:Vy,fetch:Wy};function fg(i,e,t){return i.find(n=>n.userId===e&&n.recordId===t)}function Vy(i,e,t){let n=fg(i,e,t);if(!n)throw new Error(`VLR not found: ${e}/${t}`);return n}function Wy(i,{contentOffset:e,contentLength:t}){return t===0?new Uint8Array:Rn.Getter.create(i)(e,e+t)}async function Xy(i,e){let t=Rn.Getter.create(i),n=await ug({get:t,startOffset:e.headerLength,count:e.vlrCount,isExtended:!1}),r=await ug({get:t,startOffset:e.evlrOffset,count:e.evlrCount,isExtended:!0});return[...n,...r]}function hg(i,e){return(e?Yy:qy)(i)}function qy(i){let e=Rn.Binary.toDataView(i);if(e.byteLength!==Fs.vlrHeaderLength)throw new Error(`Invalid VLR header length (must be ${Fs.vlrHeaderLength}): ${e.byteLength}`);return{userId:Rn.Binary.toCString(i.slice(2,18)),recordId:e.getUint16(18,!0),contentLength:e.getUint16(20,!0),description:Rn.Binary.toCString(i.slice(22,54)),isExtended:!1}}function Yy(i){let e=Rn.Binary.toDataView(i);if(e.byteLength!==Fs.evlrHeaderLength)throw new Error(`Invalid EVLR header length (must be ${Fs.evlrHeaderLength}): ${e.byteLength}`);return{userId:Rn.Binary.toCString(i.slice(2,18)),recordId:e.getUint16(18,!0),contentLength:(0,Rn.parseBigInt)((0,Rn.getBigUint64)(e,20,!0)),description:Rn.Binary.toCString(i.slice(28,60)),isExtended:!0}}async function ug({get:i,startOffset:e,count:t,isExtended:n}){let r=[],s=e,o=n?Fs.evlrHeaderLength:Fs.vlrHeaderLength;for(let a=0;a<t;++a){let l=o?await i(s,s+o):new Uint8Array,{userId:c,recordId:u,contentLength:h,description:d}=hg(l,n);r.push({userId:c,recordId:u,contentOffset:s+o,contentLength:h,description:d,isExtended:n}),s+=o+h}return r}});var hu=xt(Ut=>{"use strict";var $y=Ut&&Ut.__createBinding||(Object.create?(function(i,e,t,n){n===void 0&&(n=t);var r=Object.getOwnPropertyDescriptor(e,t);(!r||("get"in r?!e.__esModule:r.writable||r.configurable))&&(r={enumerable:!0,get:function(){return e[t]}}),Object.defineProperty(i,n,r)}):(function(i,e,t,n){n===void 0&&(n=t),i[n]=e[t]})),Ky=Ut&&Ut.__setModuleDefault||(Object.create?(function(i,e){Object.defineProperty(i,"default",{enumerable:!0,value:e})}):function(i,e){i.default=e}),Zy=Ut&&Ut.__importStar||function(i){if(i&&i.__esModule)return i;var e={};if(i!=null)for(var t in i)t!=="default"&&Object.prototype.hasOwnProperty.call(i,t)&&$y(e,i,t);return Ky(e,i),e};Object.defineProperty(Ut,"__esModule",{value:!0});Ut.Vlr=Ut.View=Ut.PointData=Ut.Header=Ut.Extractor=Ut.ExtraBytes=Ut.Dimensions=Ut.Constants=void 0;Ut.Constants=Zy(Al());var Jy=nu();Object.defineProperty(Ut,"Dimensions",{enumerable:!0,get:function(){return Jy.Dimensions}});var jy=iu();Object.defineProperty(Ut,"ExtraBytes",{enumerable:!0,get:function(){return jy.ExtraBytes}});var Qy=ru();Object.defineProperty(Ut,"Extractor",{enumerable:!0,get:function(){return Qy.Extractor}});var ev=ou();Object.defineProperty(Ut,"Header",{enumerable:!0,get:function(){return ev.Header}});var tv=lg();Object.defineProperty(Ut,"PointData",{enumerable:!0,get:function(){return tv.PointData}});var iv=cg();Object.defineProperty(Ut,"View",{enumerable:!0,get:function(){return iv.View}});var nv=dg();Object.defineProperty(Ut,"Vlr",{enumerable:!0,get:function(){return nv.Vlr}})});var du=xt(zl=>{"use strict";Object.defineProperty(zl,"__esModule",{value:!0});zl.Hierarchy=void 0;var Go=sn(),pg=Tl();zl.Hierarchy={parse:mg,load:rv};function mg(i){let e=Go.Binary.toDataView(i);if(e.byteLength%pg.hierarchyItemLength!==0)throw new Error(`Invalid hierarchy page length: ${e.byteLength}`);let t={},n={};for(let r=0;r<e.byteLength;r+=pg.hierarchyItemLength){let s=e.getInt32(r+0,!0),o=e.getInt32(r+4,!0),a=e.getInt32(r+8,!0),l=e.getInt32(r+12,!0),c=(0,Go.parseBigInt)((0,Go.getBigUint64)(e,r+16,!0)),u=e.getInt32(r+24,!0),h=e.getInt32(r+28,!0),d=Go.Key.toString([s,o,a,l]);if(h<-1)throw new Error(`Invalid hierarchy point count at key: ${d}`);h===-1?n[d]={pageOffset:c,pageLength:u}:t[d]={pointCount:h,pointDataOffset:c,pointDataLength:u}}return{nodes:t,pages:n}}async function rv(i,e){let t=Go.Getter.create(i);return mg(await t(e.pageOffset,e.pageOffset+e.pageLength))}});var pu=xt(kl=>{"use strict";Object.defineProperty(kl,"__esModule",{value:!0});kl.Info=void 0;var zo=sn(),gg=Tl();kl.Info={parse:sv};function sv(i){let e=zo.Binary.toDataView(i);if(e.byteLength!==gg.infoLength)throw new Error(`Invalid COPC info VLR length (should be ${gg.infoLength}): ${e.byteLength}`);let t=[e.getFloat64(0,!0),e.getFloat64(8,!0),e.getFloat64(16,!0)],n=e.getFloat64(24,!0);return{cube:[t[0]-n,t[1]-n,t[2]-n,t[0]+n,t[1]+n,t[2]+n],spacing:e.getFloat64(32,!0),rootHierarchyPage:{pageOffset:(0,zo.parseBigInt)((0,zo.getBigUint64)(e,40,!0)),pageLength:(0,zo.parseBigInt)((0,zo.getBigUint64)(e,48,!0))},gpsTimeRange:[e.getFloat64(56,!0),e.getFloat64(64,!0)]}}});var Mg=xt(wn=>{"use strict";var ov=wn&&wn.__createBinding||(Object.create?(function(i,e,t,n){n===void 0&&(n=t);var r=Object.getOwnPropertyDescriptor(e,t);(!r||("get"in r?!e.__esModule:r.writable||r.configurable))&&(r={enumerable:!0,get:function(){return e[t]}}),Object.defineProperty(i,n,r)}):(function(i,e,t,n){n===void 0&&(n=t),i[n]=e[t]})),av=wn&&wn.__setModuleDefault||(Object.create?(function(i,e){Object.defineProperty(i,"default",{enumerable:!0,value:e})}):function(i,e){i.default=e}),lv=wn&&wn.__importStar||function(i){if(i&&i.__esModule)return i;var e={};if(i!=null)for(var t in i)t!=="default"&&Object.prototype.hasOwnProperty.call(i,t)&&ov(e,i,t);return av(e,i),e};Object.defineProperty(wn,"__esModule",{value:!0});wn.Copc=void 0;var on=lv(hu()),Hl=sn(),cv=du(),uv=pu();wn.Copc={create:fv,loadHierarchyPage:hv,loadCompressedPointDataBuffer:_g,loadPointDataBuffer:xg,loadPointDataView:dv};async function fv(i){let e=Hl.Getter.create(i),t=65536,n=e(0,t);async function r(g,M){return M>=t?e(g,M):(await n).slice(g,M)}let s=on.Header.parse(await r(0,on.Constants.minHeaderLength)),o=await on.Vlr.walk(r,s),a=on.Vlr.find(o,"copc",1);if(!a)throw new Error("COPC info VLR is required");let l=uv.Info.parse(await on.Vlr.fetch(r,a)),c,u=on.Vlr.find(o,"LASF_Projection",2112);u&&u.contentLength&&(c=Hl.Binary.toCString(await on.Vlr.fetch(r,u)),c===""&&(c=void 0));let h=[],d=on.Vlr.find(o,"LASF_Spec",4);return d&&(h=on.ExtraBytes.parse(await on.Vlr.fetch(r,d))),{header:s,vlrs:o,info:l,wkt:c,eb:h}}async function hv(i,e){let t=Hl.Getter.create(i);return cv.Hierarchy.load(t,e)}async function _g(i,{pointDataOffset:e,pointDataLength:t}){return Hl.Getter.create(i)(e,e+t)}async function xg(i,{pointDataRecordFormat:e,pointDataRecordLength:t},n,r){let s=await _g(i,n),{pointCount:o}=n;return on.PointData.decompressChunk(s,{pointCount:o,pointDataRecordFormat:e,pointDataRecordLength:t},r)}async function dv(i,e,t,{lazPerf:n,include:r}={}){let s=await xg(i,e.header,t,n);return on.View.create(s,e.header,e.eb,r)}});var yg=xt(Ti=>{"use strict";var pv=Ti&&Ti.__createBinding||(Object.create?(function(i,e,t,n){n===void 0&&(n=t);var r=Object.getOwnPropertyDescriptor(e,t);(!r||("get"in r?!e.__esModule:r.writable||r.configurable))&&(r={enumerable:!0,get:function(){return e[t]}}),Object.defineProperty(i,n,r)}):(function(i,e,t,n){n===void 0&&(n=t),i[n]=e[t]})),mv=Ti&&Ti.__setModuleDefault||(Object.create?(function(i,e){Object.defineProperty(i,"default",{enumerable:!0,value:e})}):function(i,e){i.default=e}),gv=Ti&&Ti.__importStar||function(i){if(i&&i.__esModule)return i;var e={};if(i!=null)for(var t in i)t!=="default"&&Object.prototype.hasOwnProperty.call(i,t)&&pv(e,i,t);return mv(e,i),e};Object.defineProperty(Ti,"__esModule",{value:!0});Ti.Info=Ti.Hierarchy=Ti.Copc=Ti.Constants=void 0;Ti.Constants=gv(Tl());var _v=Mg();Object.defineProperty(Ti,"Copc",{enumerable:!0,get:function(){return _v.Copc}});var xv=du();Object.defineProperty(Ti,"Hierarchy",{enumerable:!0,get:function(){return xv.Hierarchy}});var Mv=pu();Object.defineProperty(Ti,"Info",{enumerable:!0,get:function(){return Mv.Info}})});var bg=xt(Ai=>{"use strict";var vg=Ai&&Ai.__createBinding||(Object.create?(function(i,e,t,n){n===void 0&&(n=t);var r=Object.getOwnPropertyDescriptor(e,t);(!r||("get"in r?!e.__esModule:r.writable||r.configurable))&&(r={enumerable:!0,get:function(){return e[t]}}),Object.defineProperty(i,n,r)}):(function(i,e,t,n){n===void 0&&(n=t),i[n]=e[t]})),yv=Ai&&Ai.__setModuleDefault||(Object.create?(function(i,e){Object.defineProperty(i,"default",{enumerable:!0,value:e})}):function(i,e){i.default=e}),Sg=Ai&&Ai.__importStar||function(i){if(i&&i.__esModule)return i;var e={};if(i!=null)for(var t in i)t!=="default"&&Object.prototype.hasOwnProperty.call(i,t)&&vg(e,i,t);return yv(e,i),e},Eg=Ai&&Ai.__exportStar||function(i,e){for(var t in i)t!=="default"&&!Object.prototype.hasOwnProperty.call(e,t)&&vg(e,i,t)};Object.defineProperty(Ai,"__esModule",{value:!0});Ai.Las=Ai.Ept=void 0;Ai.Ept=Sg(Fm());Eg(yg(),Ai);Ai.Las=Sg(hu());Eg(sn(),Ai)});var mr={LEFT:0,MIDDLE:1,RIGHT:2,ROTATE:0,DOLLY:1,PAN:2},gr={ROTATE:0,PAN:1,DOLLY_PAN:2,DOLLY_ROTATE:3},Uu=0,rc=1,Iu=2;var Hr=1,Ou=2,_r=3,Ji=0,Ot=1,wi=2,yn=0,Yn=1,sc=2,oc=3,ac=4,Nu=5;var $n=100,Bu=101,Gu=102,zu=103,ku=104,Hu=200,Vu=201,Wu=202,Xu=203,na=204,ra=205,qu=206,Yu=207,$u=208,Ku=209,Zu=210,Ju=211,ju=212,Qu=213,ef=214,Os=0,Ns=1,Bs=2,Kn=3,Gs=4,zs=5,ks=6,Hs=7,sa=0,tf=1,nf=2,zi=0,oa=1,aa=2,la=3,ca=4,ua=5,fa=6,ha=7;var lc=300,vn=301,Zn=302,da=303,pa=304,Vs=1e3,Li=1001,Ws=1002,Lt=1003,rf=1004;var Xs=1005;var Bt=1006,ma=1007;var ki=1008;var Kt=1009,ga=1010,_a=1011,In=1012,Vr=1013,ei=1014,fi=1015,ti=1016,Wr=1017,Xr=1018,ln=1020,xa=35902,Ma=35899,ya=1021,va=1022,xi=1023,Ui=1026,Hi=1027,Sa=1028,qr=1029,Vi=1030,Yr=1031;var $r=1033,Kr=33776,Zr=33777,Jr=33778,jr=33779,qs=35840,Ys=35841,$s=35842,Ks=35843,Zs=36196,Js=37492,js=37496,Qs=37488,eo=37489,xr=37490,to=37491,io=37808,no=37809,ro=37810,so=37811,oo=37812,ao=37813,lo=37814,co=37815,uo=37816,fo=37817,ho=37818,po=37819,mo=37820,go=37821,_o=36492,xo=36494,Mo=36495,yo=36283,vo=36284,Mr=36285,So=36286;var sf=3200;var cc=0,of=1,ji="",Ci="srgb",On="srgb-linear",yr="linear",lt="srgb";var Ea=7680;var af=519,lf=512,cf=513,uf=514,ba=515,ff=516,hf=517,Ta=518,Aa=519,df=35044;var uc="300 es",hi=2e3,vr=2001;function mf(i){for(let e=i.length-1;e>=0;--e)if(i[e]>=65535)return!0;return!1}function Jn(i){return document.createElementNS("http://www.w3.org/1999/xhtml",i)}function gf(){let i=Jn("canvas");return i.style.display="block",i}var pf={},Qr=null;function fc(...i){let e="THREE."+i.shift();Qr?Qr("log",e,...i):console.log(e,...i)}function _f(i){let e=i[0];if(typeof e=="string"&&e.startsWith("TSL:")){let t=i[1];t&&t.isStackTrace?i[0]+=" "+t.getLocation():i[1]='Stack trace not available. Enable "THREE.Node.captureStackTrace" to capture stack traces.'}return i}function Ce(...i){i=_f(i);let e="THREE."+i.shift();if(Qr)Qr("warn",e,...i);else{let t=i[0];t&&t.isStackTrace?console.warn(t.getError(e)):console.warn(e,...i)}}function ot(...i){i=_f(i);let e="THREE."+i.shift();if(Qr)Qr("error",e,...i);else{let t=i[0];t&&t.isStackTrace?console.error(t.getError(e)):console.error(e,...i)}}function Sr(...i){let e=i.join(" ");e in pf||(pf[e]=!0,Ce(...i))}function xf(i,e,t){return new Promise(function(n,r){function s(){switch(i.clientWaitSync(e,i.SYNC_FLUSH_COMMANDS_BIT,0)){case i.WAIT_FAILED:r();break;case i.TIMEOUT_EXPIRED:setTimeout(s,t);break;default:n()}}setTimeout(s,t)})}var Mf={[Os]:Os,[Bs]:ks,[Gs]:Gs,[Kn]:zs,[Ns]:Ns,[ks]:Bs,[Hs]:Hs,[zs]:Kn};var ii=class{addEventListener(e,t){this._listeners===void 0&&(this._listeners={});let n=this._listeners;n[e]===void 0&&(n[e]=[]),n[e].indexOf(t)===-1&&n[e].push(t)}hasEventListener(e,t){let n=this._listeners;return n===void 0?!1:n[e]!==void 0&&n[e].indexOf(t)!==-1}removeEventListener(e,t){let n=this._listeners;if(n===void 0)return;let r=n[e];if(r!==void 0){let s=r.indexOf(t);s!==-1&&r.splice(s,1)}}dispatchEvent(e){let t=this._listeners;if(t===void 0)return;let n=t[e.type];if(n!==void 0){e.target=this;let r=n.slice(0);for(let s=0,o=r.length;s<o;s++)r[s].call(this,e);e.target=null}}};var Mi=["00","01","02","03","04","05","06","07","08","09","0a","0b","0c","0d","0e","0f","10","11","12","13","14","15","16","17","18","19","1a","1b","1c","1d","1e","1f","20","21","22","23","24","25","26","27","28","29","2a","2b","2c","2d","2e","2f","30","31","32","33","34","35","36","37","38","39","3a","3b","3c","3d","3e","3f","40","41","42","43","44","45","46","47","48","49","4a","4b","4c","4d","4e","4f","50","51","52","53","54","55","56","57","58","59","5a","5b","5c","5d","5e","5f","60","61","62","63","64","65","66","67","68","69","6a","6b","6c","6d","6e","6f","70","71","72","73","74","75","76","77","78","79","7a","7b","7c","7d","7e","7f","80","81","82","83","84","85","86","87","88","89","8a","8b","8c","8d","8e","8f","90","91","92","93","94","95","96","97","98","99","9a","9b","9c","9d","9e","9f","a0","a1","a2","a3","a4","a5","a6","a7","a8","a9","aa","ab","ac","ad","ae","af","b0","b1","b2","b3","b4","b5","b6","b7","b8","b9","ba","bb","bc","bd","be","bf","c0","c1","c2","c3","c4","c5","c6","c7","c8","c9","ca","cb","cc","cd","ce","cf","d0","d1","d2","d3","d4","d5","d6","d7","d8","d9","da","db","dc","dd","de","df","e0","e1","e2","e3","e4","e5","e6","e7","e8","e9","ea","eb","ec","ed","ee","ef","f0","f1","f2","f3","f4","f5","f6","f7","f8","f9","fa","fb","fc","fd","fe","ff"],yf=1234567,es=Math.PI/180,Er=180/Math.PI;function cn(){let i=Math.random()*4294967295|0,e=Math.random()*4294967295|0,t=Math.random()*4294967295|0,n=Math.random()*4294967295|0;return(Mi[i&255]+Mi[i>>8&255]+Mi[i>>16&255]+Mi[i>>24&255]+"-"+Mi[e&255]+Mi[e>>8&255]+"-"+Mi[e>>16&15|64]+Mi[e>>24&255]+"-"+Mi[t&63|128]+Mi[t>>8&255]+"-"+Mi[t>>16&255]+Mi[t>>24&255]+Mi[n&255]+Mi[n>>8&255]+Mi[n>>16&255]+Mi[n>>24&255]).toLowerCase()}function Qe(i,e,t){return Math.max(e,Math.min(t,i))}function Ra(i,e){return(i%e+e)%e}function tx(i,e,t,n,r){return n+(i-e)*(r-n)/(t-e)}function ix(i,e,t){return i!==e?(t-i)/(e-i):0}function ts(i,e,t){return(1-t)*i+t*e}function nx(i,e,t,n){return ts(i,e,1-Math.exp(-t*n))}function rx(i,e=1){return e-Math.abs(Ra(i,e*2)-e)}function sx(i,e,t){return i<=e?0:i>=t?1:(i=(i-e)/(t-e),i*i*(3-2*i))}function ox(i,e,t){return i<=e?0:i>=t?1:(i=(i-e)/(t-e),i*i*i*(i*(i*6-15)+10))}function ax(i,e){return i+Math.floor(Math.random()*(e-i+1))}function lx(i,e){return i+Math.random()*(e-i)}function cx(i){return i*(.5-Math.random())}function ux(i){i!==void 0&&(yf=i);let e=yf+=1831565813;return e=Math.imul(e^e>>>15,e|1),e^=e+Math.imul(e^e>>>7,e|61),((e^e>>>14)>>>0)/4294967296}function fx(i){return i*es}function hx(i){return i*Er}function dx(i){return i>0&&Number.isInteger(i)&&2**Math.round(Math.log2(i))===i}function px(i){return Math.pow(2,Math.ceil(Math.log(i)/Math.LN2))}function hc(i){return Math.pow(2,Math.floor(Math.log(i)/Math.LN2))}function mx(i,e,t,n,r){let s=Math.cos,o=Math.sin,a=s(t/2),l=o(t/2),c=s((e+n)/2),u=o((e+n)/2),h=s((e-n)/2),d=o((e-n)/2),g=s((n-e)/2),M=o((n-e)/2);switch(r){case"XYX":i.set(a*u,l*h,l*d,a*c);break;case"YZY":i.set(l*d,a*u,l*h,a*c);break;case"ZXZ":i.set(l*h,l*d,a*u,a*c);break;case"XZX":i.set(a*u,l*M,l*g,a*c);break;case"YXY":i.set(l*g,a*u,l*M,a*c);break;case"ZYZ":i.set(l*M,l*g,a*u,a*c);break;default:Ce("MathUtils: .setQuaternionFromProperEuler() encountered an unknown order: "+r)}}function wa(i){switch(i.constructor){case Uint32Array:return 4294967295;case Uint16Array:return 65535;case Uint8Array:case Uint8ClampedArray:return 255;case Int32Array:return 2147483647;case Int16Array:return 32767;case Int8Array:return 127;default:return}}function dc(i,e){if(e.constructor===Float32Array)return i;let t=wa(e);if(t===void 0)throw new Error("THREE.MathUtils: Invalid component type.");return Math.max(i/t,-1)}function pc(i,e){if(e.constructor===Float32Array)return i;let t=wa(e);if(t===void 0)throw new Error("THREE.MathUtils: Invalid component type.");return Math.round(i*t)}var Eo={DEG2RAD:es,RAD2DEG:Er,generateUUID:cn,clamp:Qe,euclideanModulo:Ra,mapLinear:tx,inverseLerp:ix,lerp:ts,damp:nx,pingpong:rx,smoothstep:sx,smootherstep:ox,randInt:ax,randFloat:lx,randFloatSpread:cx,seededRandom:ux,degToRad:fx,radToDeg:hx,isPowerOfTwo:dx,ceilPowerOfTwo:px,floorPowerOfTwo:hc,setQuaternionFromProperEuler:mx,normalize:pc,denormalize:dc};var mc=class mc{constructor(e=0,t=0){this.x=e,this.y=t}get width(){return this.x}set width(e){this.x=e}get height(){return this.y}set height(e){this.y=e}set(e,t){return this.x=e,this.y=t,this}setScalar(e){return this.x=e,this.y=e,this}setX(e){return this.x=e,this}setY(e){return this.y=e,this}setComponent(e,t){switch(e){case 0:this.x=t;break;case 1:this.y=t;break;default:throw new Error("THREE.Vector2: index is out of range: "+e)}return this}getComponent(e){switch(e){case 0:return this.x;case 1:return this.y;default:throw new Error("THREE.Vector2: index is out of range: "+e)}}clone(){return new this.constructor(this.x,this.y)}copy(e){return this.x=e.x,this.y=e.y,this}add(e){return this.x+=e.x,this.y+=e.y,this}addScalar(e){return this.x+=e,this.y+=e,this}addVectors(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this}addScaledVector(e,t){return this.x+=e.x*t,this.y+=e.y*t,this}sub(e){return this.x-=e.x,this.y-=e.y,this}subScalar(e){return this.x-=e,this.y-=e,this}subVectors(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this}multiply(e){return this.x*=e.x,this.y*=e.y,this}multiplyScalar(e){return this.x*=e,this.y*=e,this}divide(e){return this.x/=e.x,this.y/=e.y,this}divideScalar(e){return this.multiplyScalar(1/e)}applyMatrix3(e){let t=this.x,n=this.y,r=e.elements;return this.x=r[0]*t+r[3]*n+r[6],this.y=r[1]*t+r[4]*n+r[7],this}min(e){return this.x=Math.min(this.x,e.x),this.y=Math.min(this.y,e.y),this}max(e){return this.x=Math.max(this.x,e.x),this.y=Math.max(this.y,e.y),this}clamp(e,t){return this.x=Qe(this.x,e.x,t.x),this.y=Qe(this.y,e.y,t.y),this}clampScalar(e,t){return this.x=Qe(this.x,e,t),this.y=Qe(this.y,e,t),this}clampLength(e,t){let n=this.length();return this.divideScalar(n||1).multiplyScalar(Qe(n,e,t))}floor(){return this.x=Math.floor(this.x),this.y=Math.floor(this.y),this}ceil(){return this.x=Math.ceil(this.x),this.y=Math.ceil(this.y),this}round(){return this.x=Math.round(this.x),this.y=Math.round(this.y),this}roundToZero(){return this.x=Math.trunc(this.x),this.y=Math.trunc(this.y),this}negate(){return this.x=-this.x,this.y=-this.y,this}dot(e){return this.x*e.x+this.y*e.y}cross(e){return this.x*e.y-this.y*e.x}lengthSq(){return this.x*this.x+this.y*this.y}length(){return Math.sqrt(this.x*this.x+this.y*this.y)}manhattanLength(){return Math.abs(this.x)+Math.abs(this.y)}normalize(){return this.divideScalar(this.length()||1)}angle(){return Math.atan2(-this.y,-this.x)+Math.PI}angleTo(e){let t=Math.sqrt(this.lengthSq()*e.lengthSq());if(t===0)return Math.PI/2;let n=this.dot(e)/t;return Math.acos(Qe(n,-1,1))}distanceTo(e){return Math.sqrt(this.distanceToSquared(e))}distanceToSquared(e){let t=this.x-e.x,n=this.y-e.y;return t*t+n*n}manhattanDistanceTo(e){return Math.abs(this.x-e.x)+Math.abs(this.y-e.y)}setLength(e){return this.normalize().multiplyScalar(e)}lerp(e,t){return this.x+=(e.x-this.x)*t,this.y+=(e.y-this.y)*t,this}lerpVectors(e,t,n){return this.x=e.x+(t.x-e.x)*n,this.y=e.y+(t.y-e.y)*n,this}equals(e){return e.x===this.x&&e.y===this.y}fromArray(e,t=0){return this.x=e[t],this.y=e[t+1],this}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e}fromBufferAttribute(e,t){return this.x=e.getX(t),this.y=e.getY(t),this}rotateAround(e,t){let n=Math.cos(t),r=Math.sin(t),s=this.x-e.x,o=this.y-e.y;return this.x=s*n-o*r+e.x,this.y=s*r+o*n+e.y,this}random(){return this.x=Math.random(),this.y=Math.random(),this}*[Symbol.iterator](){yield this.x,yield this.y}};mc.prototype.isVector2=!0;var Oe=mc;var yi=class{constructor(e=0,t=0,n=0,r=1){this.isQuaternion=!0,this._x=e,this._y=t,this._z=n,this._w=r}static slerpFlat(e,t,n,r,s,o,a){let l=n[r+0],c=n[r+1],u=n[r+2],h=n[r+3],d=s[o+0],g=s[o+1],M=s[o+2],S=s[o+3];if(h!==S||l!==d||c!==g||u!==M){let _=l*d+c*g+u*M+h*S;_<0&&(d=-d,g=-g,M=-M,S=-S,_=-_);let m=1-a;if(_<.9995){let b=Math.acos(_),w=Math.sin(b);m=Math.sin(m*b)/w,a=Math.sin(a*b)/w,l=l*m+d*a,c=c*m+g*a,u=u*m+M*a,h=h*m+S*a}else{l=l*m+d*a,c=c*m+g*a,u=u*m+M*a,h=h*m+S*a;let b=1/Math.sqrt(l*l+c*c+u*u+h*h);l*=b,c*=b,u*=b,h*=b}}e[t]=l,e[t+1]=c,e[t+2]=u,e[t+3]=h}static multiplyQuaternionsFlat(e,t,n,r,s,o){let a=n[r],l=n[r+1],c=n[r+2],u=n[r+3],h=s[o],d=s[o+1],g=s[o+2],M=s[o+3];return e[t]=a*M+u*h+l*g-c*d,e[t+1]=l*M+u*d+c*h-a*g,e[t+2]=c*M+u*g+a*d-l*h,e[t+3]=u*M-a*h-l*d-c*g,e}get x(){return this._x}set x(e){this._x=e,this._onChangeCallback()}get y(){return this._y}set y(e){this._y=e,this._onChangeCallback()}get z(){return this._z}set z(e){this._z=e,this._onChangeCallback()}get w(){return this._w}set w(e){this._w=e,this._onChangeCallback()}set(e,t,n,r){return this._x=e,this._y=t,this._z=n,this._w=r,this._onChangeCallback(),this}clone(){return new this.constructor(this._x,this._y,this._z,this._w)}copy(e){return this._x=e.x,this._y=e.y,this._z=e.z,this._w=e.w,this._onChangeCallback(),this}setFromEuler(e,t=!0){let n=e._x,r=e._y,s=e._z,o=e._order,a=Math.cos,l=Math.sin,c=a(n/2),u=a(r/2),h=a(s/2),d=l(n/2),g=l(r/2),M=l(s/2);switch(o){case"XYZ":this._x=d*u*h+c*g*M,this._y=c*g*h-d*u*M,this._z=c*u*M+d*g*h,this._w=c*u*h-d*g*M;break;case"YXZ":this._x=d*u*h+c*g*M,this._y=c*g*h-d*u*M,this._z=c*u*M-d*g*h,this._w=c*u*h+d*g*M;break;case"ZXY":this._x=d*u*h-c*g*M,this._y=c*g*h+d*u*M,this._z=c*u*M+d*g*h,this._w=c*u*h-d*g*M;break;case"ZYX":this._x=d*u*h-c*g*M,this._y=c*g*h+d*u*M,this._z=c*u*M-d*g*h,this._w=c*u*h+d*g*M;break;case"YZX":this._x=d*u*h+c*g*M,this._y=c*g*h+d*u*M,this._z=c*u*M-d*g*h,this._w=c*u*h-d*g*M;break;case"XZY":this._x=d*u*h-c*g*M,this._y=c*g*h-d*u*M,this._z=c*u*M+d*g*h,this._w=c*u*h+d*g*M;break;default:Ce("Quaternion: .setFromEuler() encountered an unknown order: "+o)}return t===!0&&this._onChangeCallback(),this}setFromAxisAngle(e,t){let n=t/2,r=Math.sin(n);return this._x=e.x*r,this._y=e.y*r,this._z=e.z*r,this._w=Math.cos(n),this._onChangeCallback(),this}setFromRotationMatrix(e){let t=e.elements,n=t[0],r=t[4],s=t[8],o=t[1],a=t[5],l=t[9],c=t[2],u=t[6],h=t[10],d=n+a+h;if(d>0){let g=.5/Math.sqrt(d+1);this._w=.25/g,this._x=(u-l)*g,this._y=(s-c)*g,this._z=(o-r)*g}else if(n>a&&n>h){let g=2*Math.sqrt(1+n-a-h);this._w=(u-l)/g,this._x=.25*g,this._y=(r+o)/g,this._z=(s+c)/g}else if(a>h){let g=2*Math.sqrt(1+a-n-h);this._w=(s-c)/g,this._x=(r+o)/g,this._y=.25*g,this._z=(l+u)/g}else{let g=2*Math.sqrt(1+h-n-a);this._w=(o-r)/g,this._x=(s+c)/g,this._y=(l+u)/g,this._z=.25*g}return this._onChangeCallback(),this}setFromUnitVectors(e,t){let n=e.dot(t)+1;return n<1e-8?(n=0,Math.abs(e.x)>Math.abs(e.z)?(this._x=-e.y,this._y=e.x,this._z=0,this._w=n):(this._x=0,this._y=-e.z,this._z=e.y,this._w=n)):(this._x=e.y*t.z-e.z*t.y,this._y=e.z*t.x-e.x*t.z,this._z=e.x*t.y-e.y*t.x,this._w=n),this.normalize()}angleTo(e){return 2*Math.acos(Math.abs(Qe(this.dot(e),-1,1)))}rotateTowards(e,t){let n=this.angleTo(e);if(n===0)return this;let r=Math.min(1,t/n);return this.slerp(e,r),this}identity(){return this.set(0,0,0,1)}invert(){return this.conjugate()}conjugate(){return this._x*=-1,this._y*=-1,this._z*=-1,this._onChangeCallback(),this}dot(e){return this._x*e._x+this._y*e._y+this._z*e._z+this._w*e._w}lengthSq(){return this._x*this._x+this._y*this._y+this._z*this._z+this._w*this._w}length(){return Math.sqrt(this._x*this._x+this._y*this._y+this._z*this._z+this._w*this._w)}normalize(){let e=this.length();return e===0?(this._x=0,this._y=0,this._z=0,this._w=1):(e=1/e,this._x=this._x*e,this._y=this._y*e,this._z=this._z*e,this._w=this._w*e),this._onChangeCallback(),this}multiply(e){return this.multiplyQuaternions(this,e)}premultiply(e){return this.multiplyQuaternions(e,this)}multiplyQuaternions(e,t){let n=e._x,r=e._y,s=e._z,o=e._w,a=t._x,l=t._y,c=t._z,u=t._w;return this._x=n*u+o*a+r*c-s*l,this._y=r*u+o*l+s*a-n*c,this._z=s*u+o*c+n*l-r*a,this._w=o*u-n*a-r*l-s*c,this._onChangeCallback(),this}slerp(e,t){let n=e._x,r=e._y,s=e._z,o=e._w,a=this.dot(e);a<0&&(n=-n,r=-r,s=-s,o=-o,a=-a);let l=1-t;if(a<.9995){let c=Math.acos(a),u=Math.sin(c);l=Math.sin(l*c)/u,t=Math.sin(t*c)/u,this._x=this._x*l+n*t,this._y=this._y*l+r*t,this._z=this._z*l+s*t,this._w=this._w*l+o*t,this._onChangeCallback()}else this._x=this._x*l+n*t,this._y=this._y*l+r*t,this._z=this._z*l+s*t,this._w=this._w*l+o*t,this.normalize();return this}slerpQuaternions(e,t,n){return this.copy(e).slerp(t,n)}random(){let e=2*Math.PI*Math.random(),t=2*Math.PI*Math.random(),n=Math.random(),r=Math.sqrt(1-n),s=Math.sqrt(n);return this.set(r*Math.sin(e),r*Math.cos(e),s*Math.sin(t),s*Math.cos(t))}equals(e){return e._x===this._x&&e._y===this._y&&e._z===this._z&&e._w===this._w}fromArray(e,t=0){return this._x=e[t],this._y=e[t+1],this._z=e[t+2],this._w=e[t+3],this._onChangeCallback(),this}toArray(e=[],t=0){return e[t]=this._x,e[t+1]=this._y,e[t+2]=this._z,e[t+3]=this._w,e}fromBufferAttribute(e,t){return this._x=e.getX(t),this._y=e.getY(t),this._z=e.getZ(t),this._w=e.getW(t),this._onChangeCallback(),this}toJSON(){return this.toArray()}_onChange(e){return this._onChangeCallback=e,this}_onChangeCallback(){}*[Symbol.iterator](){yield this._x,yield this._y,yield this._z,yield this._w}};var _c=class _c{constructor(e=0,t=0,n=0){this.x=e,this.y=t,this.z=n}set(e,t,n){return n===void 0&&(n=this.z),this.x=e,this.y=t,this.z=n,this}setScalar(e){return this.x=e,this.y=e,this.z=e,this}setX(e){return this.x=e,this}setY(e){return this.y=e,this}setZ(e){return this.z=e,this}setComponent(e,t){switch(e){case 0:this.x=t;break;case 1:this.y=t;break;case 2:this.z=t;break;default:throw new Error("THREE.Vector3: index is out of range: "+e)}return this}getComponent(e){switch(e){case 0:return this.x;case 1:return this.y;case 2:return this.z;default:throw new Error("THREE.Vector3: index is out of range: "+e)}}clone(){return new this.constructor(this.x,this.y,this.z)}copy(e){return this.x=e.x,this.y=e.y,this.z=e.z,this}add(e){return this.x+=e.x,this.y+=e.y,this.z+=e.z,this}addScalar(e){return this.x+=e,this.y+=e,this.z+=e,this}addVectors(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this.z=e.z+t.z,this}addScaledVector(e,t){return this.x+=e.x*t,this.y+=e.y*t,this.z+=e.z*t,this}sub(e){return this.x-=e.x,this.y-=e.y,this.z-=e.z,this}subScalar(e){return this.x-=e,this.y-=e,this.z-=e,this}subVectors(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this.z=e.z-t.z,this}multiply(e){return this.x*=e.x,this.y*=e.y,this.z*=e.z,this}multiplyScalar(e){return this.x*=e,this.y*=e,this.z*=e,this}multiplyVectors(e,t){return this.x=e.x*t.x,this.y=e.y*t.y,this.z=e.z*t.z,this}applyEuler(e){return this.applyQuaternion(vf.setFromEuler(e))}applyAxisAngle(e,t){return this.applyQuaternion(vf.setFromAxisAngle(e,t))}applyMatrix3(e){let t=this.x,n=this.y,r=this.z,s=e.elements;return this.x=s[0]*t+s[3]*n+s[6]*r,this.y=s[1]*t+s[4]*n+s[7]*r,this.z=s[2]*t+s[5]*n+s[8]*r,this}applyNormalMatrix(e){return this.applyMatrix3(e).normalize()}applyMatrix4(e){let t=this.x,n=this.y,r=this.z,s=e.elements,o=1/(s[3]*t+s[7]*n+s[11]*r+s[15]);return this.x=(s[0]*t+s[4]*n+s[8]*r+s[12])*o,this.y=(s[1]*t+s[5]*n+s[9]*r+s[13])*o,this.z=(s[2]*t+s[6]*n+s[10]*r+s[14])*o,this}applyQuaternion(e){let t=this.x,n=this.y,r=this.z,s=e.x,o=e.y,a=e.z,l=e.w,c=2*(o*r-a*n),u=2*(a*t-s*r),h=2*(s*n-o*t);return this.x=t+l*c+o*h-a*u,this.y=n+l*u+a*c-s*h,this.z=r+l*h+s*u-o*c,this}project(e){return this.applyMatrix4(e.matrixWorldInverse).applyMatrix4(e.projectionMatrix)}unproject(e){return this.applyMatrix4(e.projectionMatrixInverse).applyMatrix4(e.matrixWorld)}transformDirection(e){let t=this.x,n=this.y,r=this.z,s=e.elements;return this.x=s[0]*t+s[4]*n+s[8]*r,this.y=s[1]*t+s[5]*n+s[9]*r,this.z=s[2]*t+s[6]*n+s[10]*r,this.normalize()}divide(e){return this.x/=e.x,this.y/=e.y,this.z/=e.z,this}divideScalar(e){return this.multiplyScalar(1/e)}min(e){return this.x=Math.min(this.x,e.x),this.y=Math.min(this.y,e.y),this.z=Math.min(this.z,e.z),this}max(e){return this.x=Math.max(this.x,e.x),this.y=Math.max(this.y,e.y),this.z=Math.max(this.z,e.z),this}clamp(e,t){return this.x=Qe(this.x,e.x,t.x),this.y=Qe(this.y,e.y,t.y),this.z=Qe(this.z,e.z,t.z),this}clampScalar(e,t){return this.x=Qe(this.x,e,t),this.y=Qe(this.y,e,t),this.z=Qe(this.z,e,t),this}clampLength(e,t){let n=this.length();return this.divideScalar(n||1).multiplyScalar(Qe(n,e,t))}floor(){return this.x=Math.floor(this.x),this.y=Math.floor(this.y),this.z=Math.floor(this.z),this}ceil(){return this.x=Math.ceil(this.x),this.y=Math.ceil(this.y),this.z=Math.ceil(this.z),this}round(){return this.x=Math.round(this.x),this.y=Math.round(this.y),this.z=Math.round(this.z),this}roundToZero(){return this.x=Math.trunc(this.x),this.y=Math.trunc(this.y),this.z=Math.trunc(this.z),this}negate(){return this.x=-this.x,this.y=-this.y,this.z=-this.z,this}dot(e){return this.x*e.x+this.y*e.y+this.z*e.z}lengthSq(){return this.x*this.x+this.y*this.y+this.z*this.z}length(){return Math.sqrt(this.x*this.x+this.y*this.y+this.z*this.z)}manhattanLength(){return Math.abs(this.x)+Math.abs(this.y)+Math.abs(this.z)}normalize(){return this.divideScalar(this.length()||1)}setLength(e){return this.normalize().multiplyScalar(e)}lerp(e,t){return this.x+=(e.x-this.x)*t,this.y+=(e.y-this.y)*t,this.z+=(e.z-this.z)*t,this}lerpVectors(e,t,n){return this.x=e.x+(t.x-e.x)*n,this.y=e.y+(t.y-e.y)*n,this.z=e.z+(t.z-e.z)*n,this}cross(e){return this.crossVectors(this,e)}crossVectors(e,t){let n=e.x,r=e.y,s=e.z,o=t.x,a=t.y,l=t.z;return this.x=r*l-s*a,this.y=s*o-n*l,this.z=n*a-r*o,this}projectOnVector(e){let t=e.lengthSq();if(t===0)return this.set(0,0,0);let n=e.dot(this)/t;return this.copy(e).multiplyScalar(n)}projectOnPlane(e){return gc.copy(this).projectOnVector(e),this.sub(gc)}reflect(e){return this.sub(gc.copy(e).multiplyScalar(2*this.dot(e)))}angleTo(e){let t=Math.sqrt(this.lengthSq()*e.lengthSq());if(t===0)return Math.PI/2;let n=this.dot(e)/t;return Math.acos(Qe(n,-1,1))}distanceTo(e){return Math.sqrt(this.distanceToSquared(e))}distanceToSquared(e){let t=this.x-e.x,n=this.y-e.y,r=this.z-e.z;return t*t+n*n+r*r}manhattanDistanceTo(e){return Math.abs(this.x-e.x)+Math.abs(this.y-e.y)+Math.abs(this.z-e.z)}setFromSpherical(e){return this.setFromSphericalCoords(e.radius,e.phi,e.theta)}setFromSphericalCoords(e,t,n){let r=Math.sin(t)*e;return this.x=r*Math.sin(n),this.y=Math.cos(t)*e,this.z=r*Math.cos(n),this}setFromCylindrical(e){return this.setFromCylindricalCoords(e.radius,e.theta,e.y)}setFromCylindricalCoords(e,t,n){return this.x=e*Math.sin(t),this.y=n,this.z=e*Math.cos(t),this}setFromMatrixPosition(e){let t=e.elements;return this.x=t[12],this.y=t[13],this.z=t[14],this}setFromMatrixScale(e){let t=this.setFromMatrixColumn(e,0).length(),n=this.setFromMatrixColumn(e,1).length(),r=this.setFromMatrixColumn(e,2).length();return this.x=t,this.y=n,this.z=r,this}setFromMatrixColumn(e,t){return this.fromArray(e.elements,t*4)}setFromMatrix3Column(e,t){return this.fromArray(e.elements,t*3)}setFromEuler(e){return this.x=e._x,this.y=e._y,this.z=e._z,this}setFromColor(e){return this.x=e.r,this.y=e.g,this.z=e.b,this}equals(e){return e.x===this.x&&e.y===this.y&&e.z===this.z}fromArray(e,t=0){return this.x=e[t],this.y=e[t+1],this.z=e[t+2],this}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e[t+2]=this.z,e}fromBufferAttribute(e,t){return this.x=e.getX(t),this.y=e.getY(t),this.z=e.getZ(t),this}random(){return this.x=Math.random(),this.y=Math.random(),this.z=Math.random(),this}randomDirection(){let e=Math.random()*Math.PI*2,t=Math.random()*2-1,n=Math.sqrt(1-t*t);return this.x=n*Math.cos(e),this.y=t,this.z=n*Math.sin(e),this}*[Symbol.iterator](){yield this.x,yield this.y,yield this.z}};_c.prototype.isVector3=!0;var I=_c,gc=new I,vf=new yi;var Mc=class Mc{constructor(e,t,n,r,s,o,a,l,c){this.elements=[1,0,0,0,1,0,0,0,1],e!==void 0&&this.set(e,t,n,r,s,o,a,l,c)}set(e,t,n,r,s,o,a,l,c){let u=this.elements;return u[0]=e,u[1]=r,u[2]=a,u[3]=t,u[4]=s,u[5]=l,u[6]=n,u[7]=o,u[8]=c,this}identity(){return this.set(1,0,0,0,1,0,0,0,1),this}copy(e){let t=this.elements,n=e.elements;return t[0]=n[0],t[1]=n[1],t[2]=n[2],t[3]=n[3],t[4]=n[4],t[5]=n[5],t[6]=n[6],t[7]=n[7],t[8]=n[8],this}extractBasis(e,t,n){return e.setFromMatrix3Column(this,0),t.setFromMatrix3Column(this,1),n.setFromMatrix3Column(this,2),this}setFromMatrix4(e){let t=e.elements;return this.set(t[0],t[4],t[8],t[1],t[5],t[9],t[2],t[6],t[10]),this}multiply(e){return this.multiplyMatrices(this,e)}premultiply(e){return this.multiplyMatrices(e,this)}multiplyMatrices(e,t){let n=e.elements,r=t.elements,s=this.elements,o=n[0],a=n[3],l=n[6],c=n[1],u=n[4],h=n[7],d=n[2],g=n[5],M=n[8],S=r[0],_=r[3],m=r[6],b=r[1],w=r[4],R=r[7],P=r[2],C=r[5],x=r[8];return s[0]=o*S+a*b+l*P,s[3]=o*_+a*w+l*C,s[6]=o*m+a*R+l*x,s[1]=c*S+u*b+h*P,s[4]=c*_+u*w+h*C,s[7]=c*m+u*R+h*x,s[2]=d*S+g*b+M*P,s[5]=d*_+g*w+M*C,s[8]=d*m+g*R+M*x,this}multiplyScalar(e){let t=this.elements;return t[0]*=e,t[3]*=e,t[6]*=e,t[1]*=e,t[4]*=e,t[7]*=e,t[2]*=e,t[5]*=e,t[8]*=e,this}determinant(){let e=this.elements,t=e[0],n=e[1],r=e[2],s=e[3],o=e[4],a=e[5],l=e[6],c=e[7],u=e[8];return t*o*u-t*a*c-n*s*u+n*a*l+r*s*c-r*o*l}invert(){let e=this.elements,t=e[0],n=e[1],r=e[2],s=e[3],o=e[4],a=e[5],l=e[6],c=e[7],u=e[8],h=u*o-a*c,d=a*l-u*s,g=c*s-o*l,M=t*h+n*d+r*g;if(M===0)return this.set(0,0,0,0,0,0,0,0,0);let S=1/M;return e[0]=h*S,e[1]=(r*c-u*n)*S,e[2]=(a*n-r*o)*S,e[3]=d*S,e[4]=(u*t-r*l)*S,e[5]=(r*s-a*t)*S,e[6]=g*S,e[7]=(n*l-c*t)*S,e[8]=(o*t-n*s)*S,this}transpose(){let e,t=this.elements;return e=t[1],t[1]=t[3],t[3]=e,e=t[2],t[2]=t[6],t[6]=e,e=t[5],t[5]=t[7],t[7]=e,this}getNormalMatrix(e){return this.setFromMatrix4(e).invert().transpose()}transposeIntoArray(e){let t=this.elements;return e[0]=t[0],e[1]=t[3],e[2]=t[6],e[3]=t[1],e[4]=t[4],e[5]=t[7],e[6]=t[2],e[7]=t[5],e[8]=t[8],this}setUvTransform(e,t,n,r,s,o,a){let l=Math.cos(s),c=Math.sin(s);return this.set(n*l,n*c,-n*(l*o+c*a)+o+e,-r*c,r*l,-r*(-c*o+l*a)+a+t,0,0,1),this}scale(e,t){return Sr("Matrix3: .scale() is deprecated. Use .makeScale() instead."),this.premultiply(xc.makeScale(e,t)),this}rotate(e){return Sr("Matrix3: .rotate() is deprecated. Use .makeRotation() instead."),this.premultiply(xc.makeRotation(-e)),this}translate(e,t){return Sr("Matrix3: .translate() is deprecated. Use .makeTranslation() instead."),this.premultiply(xc.makeTranslation(e,t)),this}makeTranslation(e,t){return e.isVector2?this.set(1,0,e.x,0,1,e.y,0,0,1):this.set(1,0,e,0,1,t,0,0,1),this}makeRotation(e){let t=Math.cos(e),n=Math.sin(e);return this.set(t,-n,0,n,t,0,0,0,1),this}makeScale(e,t){return this.set(e,0,0,0,t,0,0,0,1),this}equals(e){let t=this.elements,n=e.elements;for(let r=0;r<9;r++)if(t[r]!==n[r])return!1;return!0}fromArray(e,t=0){for(let n=0;n<9;n++)this.elements[n]=e[n+t];return this}toArray(e=[],t=0){let n=this.elements;return e[t]=n[0],e[t+1]=n[1],e[t+2]=n[2],e[t+3]=n[3],e[t+4]=n[4],e[t+5]=n[5],e[t+6]=n[6],e[t+7]=n[7],e[t+8]=n[8],e}clone(){return new this.constructor().fromArray(this.elements)}};Mc.prototype.isMatrix3=!0;var ke=Mc,xc=new ke;var Sf=new ke().set(.4123908,.3575843,.1804808,.212639,.7151687,.0721923,.0193308,.1191948,.9505322),Ef=new ke().set(3.2409699,-1.5373832,-.4986108,-.9692436,1.8759675,.0415551,.0556301,-.203977,1.0569715);function gx(){let i={enabled:!0,workingColorSpace:On,spaces:{},convert:function(r,s,o){return this.enabled===!1||s===o||!s||!o||(this.spaces[s].transfer===lt&&(r.r=un(r.r),r.g=un(r.g),r.b=un(r.b)),this.spaces[s].primaries!==this.spaces[o].primaries&&(r.applyMatrix3(this.spaces[s].toXYZ),r.applyMatrix3(this.spaces[o].fromXYZ)),this.spaces[o].transfer===lt&&(r.r=br(r.r),r.g=br(r.g),r.b=br(r.b))),r},workingToColorSpace:function(r,s){return this.convert(r,this.workingColorSpace,s)},colorSpaceToWorking:function(r,s){return this.convert(r,s,this.workingColorSpace)},getPrimaries:function(r){return this.spaces[r].primaries},getTransfer:function(r){return r===ji?yr:this.spaces[r].transfer},getToneMappingMode:function(r){return this.spaces[r].outputColorSpaceConfig.toneMappingMode||"standard"},getLuminanceCoefficients:function(r,s=this.workingColorSpace){return r.fromArray(this.spaces[s].luminanceCoefficients)},define:function(r){Object.assign(this.spaces,r)},_getMatrix:function(r,s,o){return r.copy(this.spaces[o].fromXYZ).multiply(this.spaces[s].toXYZ)},_getDrawingBufferColorSpace:function(r){return this.spaces[r].outputColorSpaceConfig.drawingBufferColorSpace},_getUnpackColorSpace:function(r=this.workingColorSpace){return this.spaces[r].workingColorSpaceConfig.unpackColorSpace}},e=[.64,.33,.3,.6,.15,.06],t=[.2126,.7152,.0722],n=[.3127,.329];return i.define({[On]:{primaries:e,whitePoint:n,transfer:yr,toXYZ:Sf,fromXYZ:Ef,luminanceCoefficients:t,workingColorSpaceConfig:{unpackColorSpace:Ci},outputColorSpaceConfig:{drawingBufferColorSpace:Ci}},[Ci]:{primaries:e,whitePoint:n,transfer:lt,toXYZ:Sf,fromXYZ:Ef,luminanceCoefficients:t,outputColorSpaceConfig:{drawingBufferColorSpace:Ci}}}),i}var je=gx();function un(i){return i<.04045?i*.0773993808:Math.pow(i*.9478672986+.0521327014,2.4)}function br(i){return i<.0031308?i*12.92:1.055*Math.pow(i,.41666)-.055}var is,Ca=class{static getDataURL(e,t="image/png"){if(/^data:/i.test(e.src)||typeof HTMLCanvasElement>"u")return e.src;let n;if(e instanceof HTMLCanvasElement)n=e;else{is===void 0&&(is=Jn("canvas")),is.width=e.width,is.height=e.height;let r=is.getContext("2d");e instanceof ImageData?r.putImageData(e,0,0):r.drawImage(e,0,0,e.width,e.height),n=is}return n.toDataURL(t)}static sRGBToLinear(e){if(typeof HTMLImageElement<"u"&&e instanceof HTMLImageElement||typeof HTMLCanvasElement<"u"&&e instanceof HTMLCanvasElement||typeof ImageBitmap<"u"&&e instanceof ImageBitmap){let t=Jn("canvas");t.width=e.width,t.height=e.height;let n=t.getContext("2d");n.drawImage(e,0,0,e.width,e.height);let r=n.getImageData(0,0,e.width,e.height),s=r.data;for(let o=0;o<s.length;o++)s[o]=un(s[o]/255)*255;return n.putImageData(r,0,0),t}else if(e.data){let t=e.data.slice(0);for(let n=0;n<t.length;n++)t instanceof Uint8Array||t instanceof Uint8ClampedArray?t[n]=Math.floor(un(t[n]/255)*255):t[n]=un(t[n]);return{data:t,width:e.width,height:e.height}}else return Ce("ImageUtils.sRGBToLinear(): Unsupported image type. No color space conversion applied."),e}};var _x=0,jn=class{constructor(e=null){this.isTextureSource=!0,Object.defineProperty(this,"id",{value:_x++}),this.uuid=cn(),this.data=e,this.dataReady=!0,this.version=0}getSize(e){let t=this.data;return typeof HTMLVideoElement<"u"&&t instanceof HTMLVideoElement?e.set(t.videoWidth,t.videoHeight,0):typeof VideoFrame<"u"&&t instanceof VideoFrame?e.set(t.displayWidth,t.displayHeight,0):t!==null?e.set(t.width||0,t.height||0,t.depth||0):e.set(0,0,0),e}set needsUpdate(e){e===!0&&this.version++}toJSON(e){let t=e===void 0||typeof e=="string";if(!t&&e.images[this.uuid]!==void 0)return e.images[this.uuid];let n={uuid:this.uuid,url:""},r=this.data;if(r!==null){let s;if(Array.isArray(r)){s=[];for(let o=0,a=r.length;o<a;o++)r[o].isDataTexture?s.push(yc(r[o].image)):s.push(yc(r[o]))}else s=yc(r);n.url=s}return t||(e.images[this.uuid]=n),n}};function yc(i){return typeof HTMLImageElement<"u"&&i instanceof HTMLImageElement||typeof HTMLCanvasElement<"u"&&i instanceof HTMLCanvasElement||typeof ImageBitmap<"u"&&i instanceof ImageBitmap?Ca.getDataURL(i):i.data?{data:Array.from(i.data),width:i.width,height:i.height,type:i.data.constructor.name}:(Ce("Texture: Unable to serialize Texture."),{})}var xx=0,vc=new I,Nt=class i extends ii{constructor(e=i.DEFAULT_IMAGE,t=i.DEFAULT_MAPPING,n=Li,r=Li,s=Bt,o=ki,a=xi,l=Kt,c=i.DEFAULT_ANISOTROPY,u=ji){super(),this.isTexture=!0,Object.defineProperty(this,"id",{value:xx++}),this.uuid=cn(),this.name="",this.source=new jn(e),this.mipmaps=[],this.mapping=t,this.channel=0,this.wrapS=n,this.wrapT=r,this.magFilter=s,this.minFilter=o,this.anisotropy=c,this.format=a,this.internalFormat=null,this.type=l,this.offset=new Oe(0,0),this.repeat=new Oe(1,1),this.center=new Oe(0,0),this.rotation=0,this.matrixAutoUpdate=!0,this.matrix=new ke,this.generateMipmaps=!0,this.mipmapsAutoUpdate=!0,this.premultiplyAlpha=!1,this.flipY=!0,this.unpackAlignment=4,this.colorSpace=u,this.userData={},this.updateRanges=[],this.version=0,this.onUpdate=null,this.renderTarget=null,this.isRenderTargetTexture=!1,this.isArrayTexture=!!(e&&e.depth&&e.depth>1),this.pmremVersion=0,this.isPMREMTexture=!1,this.normalized=!1}get width(){return this.source.getSize(vc).x}get height(){return this.source.getSize(vc).y}get depth(){return this.source.getSize(vc).z}get image(){return this.source.data}set image(e){this.source.data=e}updateMatrix(){this.matrix.setUvTransform(this.offset.x,this.offset.y,this.repeat.x,this.repeat.y,this.rotation,this.center.x,this.center.y)}addUpdateRange(e,t){this.updateRanges.push({start:e,count:t})}clearUpdateRanges(){this.updateRanges.length=0}clone(){return new this.constructor().copy(this)}copy(e){return this.name=e.name,this.source=e.source,this.mipmaps=e.mipmaps.slice(0),this.mapping=e.mapping,this.channel=e.channel,this.wrapS=e.wrapS,this.wrapT=e.wrapT,this.magFilter=e.magFilter,this.minFilter=e.minFilter,this.anisotropy=e.anisotropy,this.format=e.format,this.internalFormat=e.internalFormat,this.type=e.type,this.normalized=e.normalized,this.offset.copy(e.offset),this.repeat.copy(e.repeat),this.center.copy(e.center),this.rotation=e.rotation,this.matrixAutoUpdate=e.matrixAutoUpdate,this.matrix.copy(e.matrix),this.generateMipmaps=e.generateMipmaps,this.mipmapsAutoUpdate=e.mipmapsAutoUpdate,this.premultiplyAlpha=e.premultiplyAlpha,this.flipY=e.flipY,this.unpackAlignment=e.unpackAlignment,this.colorSpace=e.colorSpace,this.renderTarget=e.renderTarget,this.isRenderTargetTexture=e.isRenderTargetTexture,this.isPMREMTexture=e.isPMREMTexture,this.isArrayTexture=e.isArrayTexture,this.userData=JSON.parse(JSON.stringify(e.userData)),this.needsUpdate=!0,this}setValues(e){for(let t in e){let n=e[t];if(n===void 0){Ce(`Texture.setValues(): parameter '${t}' has value of undefined.`);continue}let r=this[t];if(r===void 0){Ce(`Texture.setValues(): property '${t}' does not exist.`);continue}r&&n&&r.isVector2&&n.isVector2||r&&n&&r.isVector3&&n.isVector3||r&&n&&r.isMatrix3&&n.isMatrix3?r.copy(n):this[t]=n}}toJSON(e){let t=e===void 0||typeof e=="string";if(!t&&e.textures[this.uuid]!==void 0)return e.textures[this.uuid];let n={metadata:{version:4.7,type:"Texture",generator:"Texture.toJSON"},uuid:this.uuid,name:this.name,image:this.source.toJSON(e).uuid,mapping:this.mapping,channel:this.channel,repeat:[this.repeat.x,this.repeat.y],offset:[this.offset.x,this.offset.y],center:[this.center.x,this.center.y],rotation:this.rotation,wrap:[this.wrapS,this.wrapT],format:this.format,internalFormat:this.internalFormat,type:this.type,normalized:this.normalized,colorSpace:this.colorSpace,minFilter:this.minFilter,magFilter:this.magFilter,anisotropy:this.anisotropy,flipY:this.flipY,generateMipmaps:this.generateMipmaps,mipmapsAutoUpdate:this.mipmapsAutoUpdate,premultiplyAlpha:this.premultiplyAlpha,unpackAlignment:this.unpackAlignment};return Object.keys(this.userData).length>0&&(n.userData=this.userData),t||(e.textures[this.uuid]=n),n}dispose(){this.dispatchEvent({type:"dispose"})}transformUv(e){if(this.mapping!==lc)return e;if(e.applyMatrix3(this.matrix),e.x<0||e.x>1)switch(this.wrapS){case Vs:e.x=e.x-Math.floor(e.x);break;case Li:e.x=e.x<0?0:1;break;case Ws:Math.abs(Math.floor(e.x)%2)===1?e.x=Math.ceil(e.x)-e.x:e.x=e.x-Math.floor(e.x);break}if(e.y<0||e.y>1)switch(this.wrapT){case Vs:e.y=e.y-Math.floor(e.y);break;case Li:e.y=e.y<0?0:1;break;case Ws:Math.abs(Math.floor(e.y)%2)===1?e.y=Math.ceil(e.y)-e.y:e.y=e.y-Math.floor(e.y);break}return this.flipY&&(e.y=1-e.y),e}set needsUpdate(e){e===!0&&(this.version++,this.source.needsUpdate=!0)}set needsPMREMUpdate(e){e===!0&&this.pmremVersion++}};Nt.DEFAULT_IMAGE=null;Nt.DEFAULT_MAPPING=lc;Nt.DEFAULT_ANISOTROPY=1;var Sc=class Sc{constructor(e=0,t=0,n=0,r=1){this.x=e,this.y=t,this.z=n,this.w=r}get width(){return this.z}set width(e){this.z=e}get height(){return this.w}set height(e){this.w=e}set(e,t,n,r){return this.x=e,this.y=t,this.z=n,this.w=r,this}setScalar(e){return this.x=e,this.y=e,this.z=e,this.w=e,this}setX(e){return this.x=e,this}setY(e){return this.y=e,this}setZ(e){return this.z=e,this}setW(e){return this.w=e,this}setComponent(e,t){switch(e){case 0:this.x=t;break;case 1:this.y=t;break;case 2:this.z=t;break;case 3:this.w=t;break;default:throw new Error("THREE.Vector4: index is out of range: "+e)}return this}getComponent(e){switch(e){case 0:return this.x;case 1:return this.y;case 2:return this.z;case 3:return this.w;default:throw new Error("THREE.Vector4: index is out of range: "+e)}}clone(){return new this.constructor(this.x,this.y,this.z,this.w)}copy(e){return this.x=e.x,this.y=e.y,this.z=e.z,this.w=e.w!==void 0?e.w:1,this}add(e){return this.x+=e.x,this.y+=e.y,this.z+=e.z,this.w+=e.w,this}addScalar(e){return this.x+=e,this.y+=e,this.z+=e,this.w+=e,this}addVectors(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this.z=e.z+t.z,this.w=e.w+t.w,this}addScaledVector(e,t){return this.x+=e.x*t,this.y+=e.y*t,this.z+=e.z*t,this.w+=e.w*t,this}sub(e){return this.x-=e.x,this.y-=e.y,this.z-=e.z,this.w-=e.w,this}subScalar(e){return this.x-=e,this.y-=e,this.z-=e,this.w-=e,this}subVectors(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this.z=e.z-t.z,this.w=e.w-t.w,this}multiply(e){return this.x*=e.x,this.y*=e.y,this.z*=e.z,this.w*=e.w,this}multiplyScalar(e){return this.x*=e,this.y*=e,this.z*=e,this.w*=e,this}applyMatrix4(e){let t=this.x,n=this.y,r=this.z,s=this.w,o=e.elements;return this.x=o[0]*t+o[4]*n+o[8]*r+o[12]*s,this.y=o[1]*t+o[5]*n+o[9]*r+o[13]*s,this.z=o[2]*t+o[6]*n+o[10]*r+o[14]*s,this.w=o[3]*t+o[7]*n+o[11]*r+o[15]*s,this}divide(e){return this.x/=e.x,this.y/=e.y,this.z/=e.z,this.w/=e.w,this}divideScalar(e){return this.multiplyScalar(1/e)}setAxisAngleFromQuaternion(e){this.w=2*Math.acos(e.w);let t=Math.sqrt(1-e.w*e.w);return t<1e-4?(this.x=1,this.y=0,this.z=0):(this.x=e.x/t,this.y=e.y/t,this.z=e.z/t),this}setAxisAngleFromRotationMatrix(e){let t,n,r,s,l=e.elements,c=l[0],u=l[4],h=l[8],d=l[1],g=l[5],M=l[9],S=l[2],_=l[6],m=l[10];if(Math.abs(u-d)<.01&&Math.abs(h-S)<.01&&Math.abs(M-_)<.01){if(Math.abs(u+d)<.1&&Math.abs(h+S)<.1&&Math.abs(M+_)<.1&&Math.abs(c+g+m-3)<.1)return this.set(1,0,0,0),this;t=Math.PI;let w=(c+1)/2,R=(g+1)/2,P=(m+1)/2,C=(u+d)/4,x=(h+S)/4,A=(M+_)/4;return w>R&&w>P?w<.01?(n=0,r=.707106781,s=.707106781):(n=Math.sqrt(w),r=C/n,s=x/n):R>P?R<.01?(n=.707106781,r=0,s=.707106781):(r=Math.sqrt(R),n=C/r,s=A/r):P<.01?(n=.707106781,r=.707106781,s=0):(s=Math.sqrt(P),n=x/s,r=A/s),this.set(n,r,s,t),this}let b=Math.sqrt((_-M)*(_-M)+(h-S)*(h-S)+(d-u)*(d-u));return Math.abs(b)<.001&&(b=1),this.x=(_-M)/b,this.y=(h-S)/b,this.z=(d-u)/b,this.w=Math.acos((c+g+m-1)/2),this}setFromMatrixPosition(e){let t=e.elements;return this.x=t[12],this.y=t[13],this.z=t[14],this.w=t[15],this}min(e){return this.x=Math.min(this.x,e.x),this.y=Math.min(this.y,e.y),this.z=Math.min(this.z,e.z),this.w=Math.min(this.w,e.w),this}max(e){return this.x=Math.max(this.x,e.x),this.y=Math.max(this.y,e.y),this.z=Math.max(this.z,e.z),this.w=Math.max(this.w,e.w),this}clamp(e,t){return this.x=Qe(this.x,e.x,t.x),this.y=Qe(this.y,e.y,t.y),this.z=Qe(this.z,e.z,t.z),this.w=Qe(this.w,e.w,t.w),this}clampScalar(e,t){return this.x=Qe(this.x,e,t),this.y=Qe(this.y,e,t),this.z=Qe(this.z,e,t),this.w=Qe(this.w,e,t),this}clampLength(e,t){let n=this.length();return this.divideScalar(n||1).multiplyScalar(Qe(n,e,t))}floor(){return this.x=Math.floor(this.x),this.y=Math.floor(this.y),this.z=Math.floor(this.z),this.w=Math.floor(this.w),this}ceil(){return this.x=Math.ceil(this.x),this.y=Math.ceil(this.y),this.z=Math.ceil(this.z),this.w=Math.ceil(this.w),this}round(){return this.x=Math.round(this.x),this.y=Math.round(this.y),this.z=Math.round(this.z),this.w=Math.round(this.w),this}roundToZero(){return this.x=Math.trunc(this.x),this.y=Math.trunc(this.y),this.z=Math.trunc(this.z),this.w=Math.trunc(this.w),this}negate(){return this.x=-this.x,this.y=-this.y,this.z=-this.z,this.w=-this.w,this}dot(e){return this.x*e.x+this.y*e.y+this.z*e.z+this.w*e.w}lengthSq(){return this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w}length(){return Math.sqrt(this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w)}manhattanLength(){return Math.abs(this.x)+Math.abs(this.y)+Math.abs(this.z)+Math.abs(this.w)}normalize(){return this.divideScalar(this.length()||1)}setLength(e){return this.normalize().multiplyScalar(e)}lerp(e,t){return this.x+=(e.x-this.x)*t,this.y+=(e.y-this.y)*t,this.z+=(e.z-this.z)*t,this.w+=(e.w-this.w)*t,this}lerpVectors(e,t,n){return this.x=e.x+(t.x-e.x)*n,this.y=e.y+(t.y-e.y)*n,this.z=e.z+(t.z-e.z)*n,this.w=e.w+(t.w-e.w)*n,this}equals(e){return e.x===this.x&&e.y===this.y&&e.z===this.z&&e.w===this.w}fromArray(e,t=0){return this.x=e[t],this.y=e[t+1],this.z=e[t+2],this.w=e[t+3],this}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e[t+2]=this.z,e[t+3]=this.w,e}fromBufferAttribute(e,t){return this.x=e.getX(t),this.y=e.getY(t),this.z=e.getZ(t),this.w=e.getW(t),this}random(){return this.x=Math.random(),this.y=Math.random(),this.z=Math.random(),this.w=Math.random(),this}*[Symbol.iterator](){yield this.x,yield this.y,yield this.z,yield this.w}};Sc.prototype.isVector4=!0;var vt=Sc;var Pa=class extends ii{constructor(e=1,t=1,n={}){super(),n=Object.assign({generateMipmaps:!1,internalFormat:null,minFilter:Bt,depthBuffer:!0,stencilBuffer:!1,resolveColorBuffer:!0,resolveDepthBuffer:!0,resolveStencilBuffer:!0,storeMultisampledColorBuffer:!0,storeMultisampledDepthBuffer:!0,storeMultisampledStencilBuffer:!0,depthTexture:null,samples:0,count:1,depth:1,multiview:!1,useArrayDepthTexture:!1},n),this.isRenderTarget=!0,this.width=e,this.height=t,this.depth=n.depth,this.scissor=new vt(0,0,e,t),this.scissorTest=!1,this.viewport=new vt(0,0,e,t),this.textures=[];let r=n.count;for(let s=0;s<r;s++)this.textures[s]=new Nt({width:e,height:t,depth:n.depth}),this.textures[s].isRenderTargetTexture=!0,this.textures[s].renderTarget=this;this._setTextureOptions(n),this.depthBuffer=n.depthBuffer,this.stencilBuffer=n.stencilBuffer,this.resolveColorBuffer=n.resolveColorBuffer,this.resolveDepthBuffer=n.resolveDepthBuffer,this.resolveStencilBuffer=n.resolveStencilBuffer,this.storeMultisampledColorBuffer=n.storeMultisampledColorBuffer,this.storeMultisampledDepthBuffer=n.storeMultisampledDepthBuffer,this.storeMultisampledStencilBuffer=n.storeMultisampledStencilBuffer,this._depthTexture=null,this.depthTexture=n.depthTexture,this.samples=n.samples,this.multiview=n.multiview,this.useArrayDepthTexture=n.useArrayDepthTexture}_setTextureOptions(e={}){let t={minFilter:Bt,generateMipmaps:!1,flipY:!1,internalFormat:null};e.mapping!==void 0&&(t.mapping=e.mapping),e.wrapS!==void 0&&(t.wrapS=e.wrapS),e.wrapT!==void 0&&(t.wrapT=e.wrapT),e.wrapR!==void 0&&(t.wrapR=e.wrapR),e.magFilter!==void 0&&(t.magFilter=e.magFilter),e.minFilter!==void 0&&(t.minFilter=e.minFilter),e.format!==void 0&&(t.format=e.format),e.type!==void 0&&(t.type=e.type),e.anisotropy!==void 0&&(t.anisotropy=e.anisotropy),e.colorSpace!==void 0&&(t.colorSpace=e.colorSpace),e.flipY!==void 0&&(t.flipY=e.flipY),e.generateMipmaps!==void 0&&(t.generateMipmaps=e.generateMipmaps),e.mipmapsAutoUpdate!==void 0&&(t.mipmapsAutoUpdate=e.mipmapsAutoUpdate),e.internalFormat!==void 0&&(t.internalFormat=e.internalFormat);for(let n=0;n<this.textures.length;n++)this.textures[n].setValues(t)}get texture(){return this.textures[0]}set texture(e){this.textures[0]=e}set depthTexture(e){this._depthTexture!==null&&this._depthTexture.renderTarget===this&&(this._depthTexture.renderTarget=null),e!==null&&e.renderTarget===null&&(e.renderTarget=this),this._depthTexture=e}get depthTexture(){return this._depthTexture}setSize(e,t,n=1){if(this.width!==e||this.height!==t||this.depth!==n){this.width=e,this.height=t,this.depth=n;for(let r=0,s=this.textures.length;r<s;r++)this.textures[r].image.width=e,this.textures[r].image.height=t,this.textures[r].image.depth=n,this.textures[r].isData3DTexture!==!0&&(this.textures[r].isArrayTexture=this.textures[r].image.depth>1);this.dispose()}this.viewport.set(0,0,e,t),this.scissor.set(0,0,e,t)}clone(){return new this.constructor().copy(this)}copy(e){this.width=e.width,this.height=e.height,this.depth=e.depth,this.scissor.copy(e.scissor),this.scissorTest=e.scissorTest,this.viewport.copy(e.viewport),this.textures.length=0;for(let t=0,n=e.textures.length;t<n;t++){this.textures[t]=e.textures[t].clone(),this.textures[t].isRenderTargetTexture=!0,this.textures[t].renderTarget=this;let r=Object.assign({},e.textures[t].image);this.textures[t].source=new jn(r)}if(this.depthBuffer=e.depthBuffer,this.stencilBuffer=e.stencilBuffer,this.resolveColorBuffer=e.resolveColorBuffer,this.resolveDepthBuffer=e.resolveDepthBuffer,this.resolveStencilBuffer=e.resolveStencilBuffer,this.storeMultisampledColorBuffer=e.storeMultisampledColorBuffer,this.storeMultisampledDepthBuffer=e.storeMultisampledDepthBuffer,this.storeMultisampledStencilBuffer=e.storeMultisampledStencilBuffer,e.depthTexture!==null)if(e.depthTexture.renderTarget===e){let t=e.depthTexture.clone();t.renderTarget=null,this.depthTexture=t}else this.depthTexture=e.depthTexture;else this.depthTexture=null;return this.samples=e.samples,this.multiview=e.multiview,this.useArrayDepthTexture=e.useArrayDepthTexture,this}dispose(){this.dispatchEvent({type:"dispose"})}};var di=class extends Pa{constructor(e=1,t=1,n={}){super(e,t,n),this.isWebGLRenderTarget=!0}};var ns=class extends Nt{constructor(e=null,t=1,n=1,r=1){super(null),this.isDataArrayTexture=!0,this.image={data:e,width:t,height:n,depth:r},this.magFilter=Lt,this.minFilter=Lt,this.wrapR=Li,this.generateMipmaps=!1,this.flipY=!1,this.unpackAlignment=1,this.layerUpdates=new Set}copy(e){return super.copy(e),this.wrapR=e.wrapR,this}addLayerUpdate(e){this.layerUpdates.add(e)}clearLayerUpdates(){this.layerUpdates.clear()}};var Fa=class extends Nt{constructor(e=null,t=1,n=1,r=1){super(null),this.isData3DTexture=!0,this.image={data:e,width:t,height:n,depth:r},this.magFilter=Lt,this.minFilter=Lt,this.wrapR=Li,this.generateMipmaps=!1,this.flipY=!1,this.unpackAlignment=1}copy(e){return super.copy(e),this.wrapR=e.wrapR,this}};var La=class La{constructor(e,t,n,r,s,o,a,l,c,u,h,d,g,M,S,_){this.elements=[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],e!==void 0&&this.set(e,t,n,r,s,o,a,l,c,u,h,d,g,M,S,_)}set(e,t,n,r,s,o,a,l,c,u,h,d,g,M,S,_){let m=this.elements;return m[0]=e,m[4]=t,m[8]=n,m[12]=r,m[1]=s,m[5]=o,m[9]=a,m[13]=l,m[2]=c,m[6]=u,m[10]=h,m[14]=d,m[3]=g,m[7]=M,m[11]=S,m[15]=_,this}identity(){return this.set(1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1),this}clone(){return new La().fromArray(this.elements)}copy(e){let t=this.elements,n=e.elements;return t[0]=n[0],t[1]=n[1],t[2]=n[2],t[3]=n[3],t[4]=n[4],t[5]=n[5],t[6]=n[6],t[7]=n[7],t[8]=n[8],t[9]=n[9],t[10]=n[10],t[11]=n[11],t[12]=n[12],t[13]=n[13],t[14]=n[14],t[15]=n[15],this}copyPosition(e){let t=this.elements,n=e.elements;return t[12]=n[12],t[13]=n[13],t[14]=n[14],this}setFromMatrix3(e){let t=e.elements;return this.set(t[0],t[3],t[6],0,t[1],t[4],t[7],0,t[2],t[5],t[8],0,0,0,0,1),this}extractBasis(e,t,n){return this.determinantAffine()===0?(e.set(1,0,0),t.set(0,1,0),n.set(0,0,1),this):(e.setFromMatrixColumn(this,0),t.setFromMatrixColumn(this,1),n.setFromMatrixColumn(this,2),this)}makeBasis(e,t,n){return this.set(e.x,t.x,n.x,0,e.y,t.y,n.y,0,e.z,t.z,n.z,0,0,0,0,1),this}extractRotation(e){if(e.determinantAffine()===0)return this.identity();let t=this.elements,n=e.elements,r=1/rs.setFromMatrixColumn(e,0).length(),s=1/rs.setFromMatrixColumn(e,1).length(),o=1/rs.setFromMatrixColumn(e,2).length();return t[0]=n[0]*r,t[1]=n[1]*r,t[2]=n[2]*r,t[3]=0,t[4]=n[4]*s,t[5]=n[5]*s,t[6]=n[6]*s,t[7]=0,t[8]=n[8]*o,t[9]=n[9]*o,t[10]=n[10]*o,t[11]=0,t[12]=0,t[13]=0,t[14]=0,t[15]=1,this}makeRotationFromEuler(e){let t=this.elements,n=e.x,r=e.y,s=e.z,o=Math.cos(n),a=Math.sin(n),l=Math.cos(r),c=Math.sin(r),u=Math.cos(s),h=Math.sin(s);if(e.order==="XYZ"){let d=o*u,g=o*h,M=a*u,S=a*h;t[0]=l*u,t[4]=-l*h,t[8]=c,t[1]=g+M*c,t[5]=d-S*c,t[9]=-a*l,t[2]=S-d*c,t[6]=M+g*c,t[10]=o*l}else if(e.order==="YXZ"){let d=l*u,g=l*h,M=c*u,S=c*h;t[0]=d+S*a,t[4]=M*a-g,t[8]=o*c,t[1]=o*h,t[5]=o*u,t[9]=-a,t[2]=g*a-M,t[6]=S+d*a,t[10]=o*l}else if(e.order==="ZXY"){let d=l*u,g=l*h,M=c*u,S=c*h;t[0]=d-S*a,t[4]=-o*h,t[8]=M+g*a,t[1]=g+M*a,t[5]=o*u,t[9]=S-d*a,t[2]=-o*c,t[6]=a,t[10]=o*l}else if(e.order==="ZYX"){let d=o*u,g=o*h,M=a*u,S=a*h;t[0]=l*u,t[4]=M*c-g,t[8]=d*c+S,t[1]=l*h,t[5]=S*c+d,t[9]=g*c-M,t[2]=-c,t[6]=a*l,t[10]=o*l}else if(e.order==="YZX"){let d=o*l,g=o*c,M=a*l,S=a*c;t[0]=l*u,t[4]=S-d*h,t[8]=M*h+g,t[1]=h,t[5]=o*u,t[9]=-a*u,t[2]=-c*u,t[6]=g*h+M,t[10]=d-S*h}else if(e.order==="XZY"){let d=o*l,g=o*c,M=a*l,S=a*c;t[0]=l*u,t[4]=-h,t[8]=c*u,t[1]=d*h+S,t[5]=o*u,t[9]=g*h-M,t[2]=M*h-g,t[6]=a*u,t[10]=S*h+d}return t[3]=0,t[7]=0,t[11]=0,t[12]=0,t[13]=0,t[14]=0,t[15]=1,this}makeRotationFromQuaternion(e){return this.compose(Mx,e,yx)}lookAt(e,t,n){let r=this.elements;return Wi.subVectors(e,t),Wi.lengthSq()===0&&(Wi.z=1),Wi.normalize(),Qn.crossVectors(n,Wi),Qn.lengthSq()===0&&(Math.abs(n.z)===1?Wi.x+=1e-4:Wi.z+=1e-4,Wi.normalize(),Qn.crossVectors(n,Wi)),Qn.normalize(),Da.crossVectors(Wi,Qn),r[0]=Qn.x,r[4]=Da.x,r[8]=Wi.x,r[1]=Qn.y,r[5]=Da.y,r[9]=Wi.y,r[2]=Qn.z,r[6]=Da.z,r[10]=Wi.z,this}multiply(e){return this.multiplyMatrices(this,e)}premultiply(e){return this.multiplyMatrices(e,this)}multiplyMatrices(e,t){let n=e.elements,r=t.elements,s=this.elements,o=n[0],a=n[4],l=n[8],c=n[12],u=n[1],h=n[5],d=n[9],g=n[13],M=n[2],S=n[6],_=n[10],m=n[14],b=n[3],w=n[7],R=n[11],P=n[15],C=r[0],x=r[4],A=r[8],V=r[12],N=r[1],G=r[5],W=r[9],ee=r[13],U=r[2],$=r[6],ne=r[10],O=r[14],ue=r[3],K=r[7],re=r[11],le=r[15];return s[0]=o*C+a*N+l*U+c*ue,s[4]=o*x+a*G+l*$+c*K,s[8]=o*A+a*W+l*ne+c*re,s[12]=o*V+a*ee+l*O+c*le,s[1]=u*C+h*N+d*U+g*ue,s[5]=u*x+h*G+d*$+g*K,s[9]=u*A+h*W+d*ne+g*re,s[13]=u*V+h*ee+d*O+g*le,s[2]=M*C+S*N+_*U+m*ue,s[6]=M*x+S*G+_*$+m*K,s[10]=M*A+S*W+_*ne+m*re,s[14]=M*V+S*ee+_*O+m*le,s[3]=b*C+w*N+R*U+P*ue,s[7]=b*x+w*G+R*$+P*K,s[11]=b*A+w*W+R*ne+P*re,s[15]=b*V+w*ee+R*O+P*le,this}multiplyScalar(e){let t=this.elements;return t[0]*=e,t[4]*=e,t[8]*=e,t[12]*=e,t[1]*=e,t[5]*=e,t[9]*=e,t[13]*=e,t[2]*=e,t[6]*=e,t[10]*=e,t[14]*=e,t[3]*=e,t[7]*=e,t[11]*=e,t[15]*=e,this}determinant(){let e=this.elements,t=e[0],n=e[4],r=e[8],s=e[12],o=e[1],a=e[5],l=e[9],c=e[13],u=e[2],h=e[6],d=e[10],g=e[14],M=e[3],S=e[7],_=e[11],m=e[15],b=l*g-c*d,w=a*g-c*h,R=a*d-l*h,P=o*g-c*u,C=o*d-l*u,x=o*h-a*u;return t*(S*b-_*w+m*R)-n*(M*b-_*P+m*C)+r*(M*w-S*P+m*x)-s*(M*R-S*C+_*x)}determinantAffine(){let e=this.elements,t=e[0],n=e[4],r=e[8],s=e[1],o=e[5],a=e[9],l=e[2],c=e[6],u=e[10];return t*(o*u-a*c)-n*(s*u-a*l)+r*(s*c-o*l)}transpose(){let e=this.elements,t;return t=e[1],e[1]=e[4],e[4]=t,t=e[2],e[2]=e[8],e[8]=t,t=e[6],e[6]=e[9],e[9]=t,t=e[3],e[3]=e[12],e[12]=t,t=e[7],e[7]=e[13],e[13]=t,t=e[11],e[11]=e[14],e[14]=t,this}setPosition(e,t,n){let r=this.elements;return e.isVector3?(r[12]=e.x,r[13]=e.y,r[14]=e.z):(r[12]=e,r[13]=t,r[14]=n),this}invert(){let e=this.elements,t=e[0],n=e[1],r=e[2],s=e[3],o=e[4],a=e[5],l=e[6],c=e[7],u=e[8],h=e[9],d=e[10],g=e[11],M=e[12],S=e[13],_=e[14],m=e[15],b=t*a-n*o,w=t*l-r*o,R=t*c-s*o,P=n*l-r*a,C=n*c-s*a,x=r*c-s*l,A=u*S-h*M,V=u*_-d*M,N=u*m-g*M,G=h*_-d*S,W=h*m-g*S,ee=d*m-g*_,U=b*ee-w*W+R*G+P*N-C*V+x*A;if(U===0)return this.set(0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0);let $=1/U;return e[0]=(a*ee-l*W+c*G)*$,e[1]=(r*W-n*ee-s*G)*$,e[2]=(S*x-_*C+m*P)*$,e[3]=(d*C-h*x-g*P)*$,e[4]=(l*N-o*ee-c*V)*$,e[5]=(t*ee-r*N+s*V)*$,e[6]=(_*R-M*x-m*w)*$,e[7]=(u*x-d*R+g*w)*$,e[8]=(o*W-a*N+c*A)*$,e[9]=(n*N-t*W-s*A)*$,e[10]=(M*C-S*R+m*b)*$,e[11]=(h*R-u*C-g*b)*$,e[12]=(a*V-o*G-l*A)*$,e[13]=(t*G-n*V+r*A)*$,e[14]=(S*w-M*P-_*b)*$,e[15]=(u*P-h*w+d*b)*$,this}scale(e){let t=this.elements,n=e.x,r=e.y,s=e.z;return t[0]*=n,t[4]*=r,t[8]*=s,t[1]*=n,t[5]*=r,t[9]*=s,t[2]*=n,t[6]*=r,t[10]*=s,t[3]*=n,t[7]*=r,t[11]*=s,this}getMaxScaleOnAxis(){let e=this.elements,t=e[0]*e[0]+e[1]*e[1]+e[2]*e[2],n=e[4]*e[4]+e[5]*e[5]+e[6]*e[6],r=e[8]*e[8]+e[9]*e[9]+e[10]*e[10];return Math.sqrt(Math.max(t,n,r))}makeTranslation(e,t,n){return e.isVector3?this.set(1,0,0,e.x,0,1,0,e.y,0,0,1,e.z,0,0,0,1):this.set(1,0,0,e,0,1,0,t,0,0,1,n,0,0,0,1),this}makeRotationX(e){let t=Math.cos(e),n=Math.sin(e);return this.set(1,0,0,0,0,t,-n,0,0,n,t,0,0,0,0,1),this}makeRotationY(e){let t=Math.cos(e),n=Math.sin(e);return this.set(t,0,n,0,0,1,0,0,-n,0,t,0,0,0,0,1),this}makeRotationZ(e){let t=Math.cos(e),n=Math.sin(e);return this.set(t,-n,0,0,n,t,0,0,0,0,1,0,0,0,0,1),this}makeRotationAxis(e,t){let n=Math.cos(t),r=Math.sin(t),s=1-n,o=e.x,a=e.y,l=e.z,c=s*o,u=s*a;return this.set(c*o+n,c*a-r*l,c*l+r*a,0,c*a+r*l,u*a+n,u*l-r*o,0,c*l-r*a,u*l+r*o,s*l*l+n,0,0,0,0,1),this}makeScale(e,t,n){return this.set(e,0,0,0,0,t,0,0,0,0,n,0,0,0,0,1),this}makeShear(e,t,n,r,s,o){return this.set(1,n,s,0,e,1,o,0,t,r,1,0,0,0,0,1),this}compose(e,t,n){let r=this.elements,s=t._x,o=t._y,a=t._z,l=t._w,c=s+s,u=o+o,h=a+a,d=s*c,g=s*u,M=s*h,S=o*u,_=o*h,m=a*h,b=l*c,w=l*u,R=l*h,P=n.x,C=n.y,x=n.z;return r[0]=(1-(S+m))*P,r[1]=(g+R)*P,r[2]=(M-w)*P,r[3]=0,r[4]=(g-R)*C,r[5]=(1-(d+m))*C,r[6]=(_+b)*C,r[7]=0,r[8]=(M+w)*x,r[9]=(_-b)*x,r[10]=(1-(d+S))*x,r[11]=0,r[12]=e.x,r[13]=e.y,r[14]=e.z,r[15]=1,this}decompose(e,t,n){let r=this.elements;e.x=r[12],e.y=r[13],e.z=r[14];let s=this.determinantAffine();if(s===0)return n.set(1,1,1),t.identity(),this;let o=rs.set(r[0],r[1],r[2]).length(),a=rs.set(r[4],r[5],r[6]).length(),l=rs.set(r[8],r[9],r[10]).length();s<0&&(o=-o),fn.copy(this);let c=1/o,u=1/a,h=1/l;return fn.elements[0]*=c,fn.elements[1]*=c,fn.elements[2]*=c,fn.elements[4]*=u,fn.elements[5]*=u,fn.elements[6]*=u,fn.elements[8]*=h,fn.elements[9]*=h,fn.elements[10]*=h,t.setFromRotationMatrix(fn),n.x=o,n.y=a,n.z=l,this}makePerspective(e,t,n,r,s,o,a=hi,l=!1){let c=this.elements,u=2*s/(t-e),h=2*s/(n-r),d=(t+e)/(t-e),g=(n+r)/(n-r),M,S;if(l)M=s/(o-s),S=o*s/(o-s);else if(a===hi)M=-(o+s)/(o-s),S=-2*o*s/(o-s);else if(a===vr)M=-o/(o-s),S=-o*s/(o-s);else throw new Error("THREE.Matrix4.makePerspective(): Invalid coordinate system: "+a);return c[0]=u,c[4]=0,c[8]=d,c[12]=0,c[1]=0,c[5]=h,c[9]=g,c[13]=0,c[2]=0,c[6]=0,c[10]=M,c[14]=S,c[3]=0,c[7]=0,c[11]=-1,c[15]=0,this}makeOrthographic(e,t,n,r,s,o,a=hi,l=!1){let c=this.elements,u=2/(t-e),h=2/(n-r),d=-(t+e)/(t-e),g=-(n+r)/(n-r),M,S;if(l)M=1/(o-s),S=o/(o-s);else if(a===hi)M=-2/(o-s),S=-(o+s)/(o-s);else if(a===vr)M=-1/(o-s),S=-s/(o-s);else throw new Error("THREE.Matrix4.makeOrthographic(): Invalid coordinate system: "+a);return c[0]=u,c[4]=0,c[8]=0,c[12]=d,c[1]=0,c[5]=h,c[9]=0,c[13]=g,c[2]=0,c[6]=0,c[10]=M,c[14]=S,c[3]=0,c[7]=0,c[11]=0,c[15]=1,this}equals(e){let t=this.elements,n=e.elements;for(let r=0;r<16;r++)if(t[r]!==n[r])return!1;return!0}fromArray(e,t=0){for(let n=0;n<16;n++)this.elements[n]=e[n+t];return this}toArray(e=[],t=0){let n=this.elements;return e[t]=n[0],e[t+1]=n[1],e[t+2]=n[2],e[t+3]=n[3],e[t+4]=n[4],e[t+5]=n[5],e[t+6]=n[6],e[t+7]=n[7],e[t+8]=n[8],e[t+9]=n[9],e[t+10]=n[10],e[t+11]=n[11],e[t+12]=n[12],e[t+13]=n[13],e[t+14]=n[14],e[t+15]=n[15],e}};La.prototype.isMatrix4=!0;var tt=La,rs=new I,fn=new tt,Mx=new I(0,0,0),yx=new I(1,1,1),Qn=new I,Da=new I,Wi=new I;var bf=new tt,Tf=new yi,Sn=class i{constructor(e=0,t=0,n=0,r=i.DEFAULT_ORDER){this.isEuler=!0,this._x=e,this._y=t,this._z=n,this._order=r}get x(){return this._x}set x(e){this._x=e,this._onChangeCallback()}get y(){return this._y}set y(e){this._y=e,this._onChangeCallback()}get z(){return this._z}set z(e){this._z=e,this._onChangeCallback()}get order(){return this._order}set order(e){this._order=e,this._onChangeCallback()}set(e,t,n,r=this._order){return this._x=e,this._y=t,this._z=n,this._order=r,this._onChangeCallback(),this}clone(){return new this.constructor(this._x,this._y,this._z,this._order)}copy(e){return this._x=e._x,this._y=e._y,this._z=e._z,this._order=e._order,this._onChangeCallback(),this}setFromRotationMatrix(e,t=this._order,n=!0){let r=e.elements,s=r[0],o=r[4],a=r[8],l=r[1],c=r[5],u=r[9],h=r[2],d=r[6],g=r[10];switch(t){case"XYZ":this._y=Math.asin(Qe(a,-1,1)),Math.abs(a)<.9999999?(this._x=Math.atan2(-u,g),this._z=Math.atan2(-o,s)):(this._x=Math.atan2(d,c),this._z=0);break;case"YXZ":this._x=Math.asin(-Qe(u,-1,1)),Math.abs(u)<.9999999?(this._y=Math.atan2(a,g),this._z=Math.atan2(l,c)):(this._y=Math.atan2(-h,s),this._z=0);break;case"ZXY":this._x=Math.asin(Qe(d,-1,1)),Math.abs(d)<.9999999?(this._y=Math.atan2(-h,g),this._z=Math.atan2(-o,c)):(this._y=0,this._z=Math.atan2(l,s));break;case"ZYX":this._y=Math.asin(-Qe(h,-1,1)),Math.abs(h)<.9999999?(this._x=Math.atan2(d,g),this._z=Math.atan2(l,s)):(this._x=0,this._z=Math.atan2(-o,c));break;case"YZX":this._z=Math.asin(Qe(l,-1,1)),Math.abs(l)<.9999999?(this._x=Math.atan2(-u,c),this._y=Math.atan2(-h,s)):(this._x=0,this._y=Math.atan2(a,g));break;case"XZY":this._z=Math.asin(-Qe(o,-1,1)),Math.abs(o)<.9999999?(this._x=Math.atan2(d,c),this._y=Math.atan2(a,s)):(this._x=Math.atan2(-u,g),this._y=0);break;default:Ce("Euler: .setFromRotationMatrix() encountered an unknown order: "+t)}return this._order=t,n===!0&&this._onChangeCallback(),this}setFromQuaternion(e,t,n){return bf.makeRotationFromQuaternion(e),this.setFromRotationMatrix(bf,t,n)}setFromVector3(e,t=this._order){return this.set(e.x,e.y,e.z,t)}reorder(e){return Tf.setFromEuler(this),this.setFromQuaternion(Tf,e)}equals(e){return e._x===this._x&&e._y===this._y&&e._z===this._z&&e._order===this._order}fromArray(e){return this._x=e[0],this._y=e[1],this._z=e[2],e[3]!==void 0&&(this._order=e[3]),this._onChangeCallback(),this}toArray(e=[],t=0){return e[t]=this._x,e[t+1]=this._y,e[t+2]=this._z,e[t+3]=this._order,e}_onChange(e){return this._onChangeCallback=e,this}_onChangeCallback(){}*[Symbol.iterator](){yield this._x,yield this._y,yield this._z,yield this._order}};Sn.DEFAULT_ORDER="XYZ";var er=class{constructor(){this.mask=1}set(e){this.mask=(1<<e|0)>>>0}enable(e){this.mask|=1<<e|0}enableAll(){this.mask=-1}toggle(e){this.mask^=1<<e|0}disable(e){this.mask&=~(1<<e|0)}disableAll(){this.mask=0}test(e){return(this.mask&e.mask)!==0}isEnabled(e){return(this.mask&(1<<e|0))!==0}};var vx=0,Af=new I,ss=new yi,Nn=new tt,Ua=new I,bo=new I,Sx=new I,Ex=new yi,Rf=new I(1,0,0),wf=new I(0,1,0),Cf=new I(0,0,1),Pf={type:"added"},bx={type:"removed"},os={type:"childadded",child:null},Ec={type:"childremoved",child:null},Vt=class i extends ii{constructor(){super(),this.isObject3D=!0,Object.defineProperty(this,"id",{value:vx++}),this.uuid=cn(),this.name="",this.type="Object3D",this.parent=null,this.children=[],this.up=i.DEFAULT_UP.clone();let e=new I,t=new Sn,n=new yi,r=new I(1,1,1);function s(){n.setFromEuler(t,!1)}function o(){t.setFromQuaternion(n,void 0,!1)}t._onChange(s),n._onChange(o),Object.defineProperties(this,{position:{configurable:!0,enumerable:!0,value:e},rotation:{configurable:!0,enumerable:!0,value:t},quaternion:{configurable:!0,enumerable:!0,value:n},scale:{configurable:!0,enumerable:!0,value:r},modelViewMatrix:{value:new tt},normalMatrix:{value:new ke}}),this.matrix=new tt,this.matrixWorld=new tt,this.matrixAutoUpdate=i.DEFAULT_MATRIX_AUTO_UPDATE,this.matrixWorldAutoUpdate=i.DEFAULT_MATRIX_WORLD_AUTO_UPDATE,this.matrixWorldNeedsUpdate=!1,this.layers=new er,this.visible=!0,this.castShadow=!1,this.receiveShadow=!1,this.frustumCulled=!0,this.renderOrder=0,this.animations=[],this.customDepthMaterial=void 0,this.customDistanceMaterial=void 0,this.static=!1,this.userData={},this.pivot=null}onBeforeShadow(){}onAfterShadow(){}onBeforeRender(){}onAfterRender(){}applyMatrix4(e){this.matrixAutoUpdate&&this.updateMatrix(),this.matrix.premultiply(e),this.matrix.decompose(this.position,this.quaternion,this.scale),this.pivot!==null&&this.position.copy(this.pivot).applyMatrix4(this.matrix).sub(this.pivot)}applyQuaternion(e){return this.quaternion.premultiply(e),this}setRotationFromAxisAngle(e,t){this.quaternion.setFromAxisAngle(e,t)}setRotationFromEuler(e){this.quaternion.setFromEuler(e,!0)}setRotationFromMatrix(e){this.quaternion.setFromRotationMatrix(e)}setRotationFromQuaternion(e){this.quaternion.copy(e)}rotateOnAxis(e,t){return ss.setFromAxisAngle(e,t),this.quaternion.multiply(ss),this}rotateOnWorldAxis(e,t){return ss.setFromAxisAngle(e,t),this.quaternion.premultiply(ss),this}rotateX(e){return this.rotateOnAxis(Rf,e)}rotateY(e){return this.rotateOnAxis(wf,e)}rotateZ(e){return this.rotateOnAxis(Cf,e)}translateOnAxis(e,t){return Af.copy(e).applyQuaternion(this.quaternion),this.position.add(Af.multiplyScalar(t)),this}translateX(e){return this.translateOnAxis(Rf,e)}translateY(e){return this.translateOnAxis(wf,e)}translateZ(e){return this.translateOnAxis(Cf,e)}localToWorld(e){return this.updateWorldMatrix(!0,!1),e.applyMatrix4(this.matrixWorld)}worldToLocal(e){return this.updateWorldMatrix(!0,!1),e.applyMatrix4(Nn.copy(this.matrixWorld).invert())}lookAt(e,t,n){e.isVector3?Ua.copy(e):Ua.set(e,t,n);let r=this.parent;this.updateWorldMatrix(!0,!1),bo.setFromMatrixPosition(this.matrixWorld),this.isCamera||this.isLight?Nn.lookAt(bo,Ua,this.up):Nn.lookAt(Ua,bo,this.up),this.quaternion.setFromRotationMatrix(Nn),r&&(Nn.extractRotation(r.matrixWorld),ss.setFromRotationMatrix(Nn),this.quaternion.premultiply(ss.invert()))}add(e){if(arguments.length>1){for(let t=0;t<arguments.length;t++)this.add(arguments[t]);return this}return e===this?(ot("Object3D.add: object can't be added as a child of itself.",e),this):(e&&e.isObject3D?(e.removeFromParent(),e.parent=this,this.children.push(e),e.dispatchEvent(Pf),os.child=e,this.dispatchEvent(os),os.child=null):ot("Object3D.add: object not an instance of THREE.Object3D.",e),this)}remove(e){if(arguments.length>1){for(let n=0;n<arguments.length;n++)this.remove(arguments[n]);return this}let t=this.children.indexOf(e);return t!==-1&&(e.parent=null,this.children.splice(t,1),e.dispatchEvent(bx),Ec.child=e,this.dispatchEvent(Ec),Ec.child=null),this}removeFromParent(){let e=this.parent;return e!==null&&e.remove(this),this}clear(){return this.remove(...this.children)}attach(e){return this.updateWorldMatrix(!0,!1),Nn.copy(this.matrixWorld).invert(),e.parent!==null&&(e.parent.updateWorldMatrix(!0,!1),Nn.multiply(e.parent.matrixWorld)),e.applyMatrix4(Nn),e.removeFromParent(),e.parent=this,this.children.push(e),e.updateWorldMatrix(!1,!0),e.dispatchEvent(Pf),os.child=e,this.dispatchEvent(os),os.child=null,this}getObjectById(e){return this.getObjectByProperty("id",e)}getObjectByName(e){return this.getObjectByProperty("name",e)}getObjectByProperty(e,t){if(this[e]===t)return this;for(let n=0,r=this.children.length;n<r;n++){let o=this.children[n].getObjectByProperty(e,t);if(o!==void 0)return o}}getObjectsByProperty(e,t,n=[]){this[e]===t&&n.push(this);let r=this.children;for(let s=0,o=r.length;s<o;s++)r[s].getObjectsByProperty(e,t,n);return n}getWorldPosition(e){return this.updateWorldMatrix(!0,!1),e.setFromMatrixPosition(this.matrixWorld)}getWorldQuaternion(e){return this.updateWorldMatrix(!0,!1),this.matrixWorld.decompose(bo,e,Sx),e}getWorldScale(e){return this.updateWorldMatrix(!0,!1),this.matrixWorld.decompose(bo,Ex,e),e}getWorldDirection(e){this.updateWorldMatrix(!0,!1);let t=this.matrixWorld.elements;return e.set(t[8],t[9],t[10]).normalize()}raycast(){}intersectsFrustum(){return!0}traverse(e){e(this);let t=this.children;for(let n=0,r=t.length;n<r;n++)t[n].traverse(e)}traverseVisible(e){if(this.visible===!1)return;e(this);let t=this.children;for(let n=0,r=t.length;n<r;n++)t[n].traverseVisible(e)}traverseAncestors(e){let t=this.parent;t!==null&&(e(t),t.traverseAncestors(e))}updateMatrix(){this.matrix.compose(this.position,this.quaternion,this.scale);let e=this.pivot;if(e!==null){let t=e.x,n=e.y,r=e.z,s=this.matrix.elements;s[12]+=t-s[0]*t-s[4]*n-s[8]*r,s[13]+=n-s[1]*t-s[5]*n-s[9]*r,s[14]+=r-s[2]*t-s[6]*n-s[10]*r}this.matrixWorldNeedsUpdate=!0}updateMatrixWorld(e){this.matrixAutoUpdate&&this.updateMatrix(),(this.matrixWorldNeedsUpdate||e)&&(this.matrixWorldAutoUpdate===!0&&(this.parent===null?this.matrixWorld.copy(this.matrix):this.matrixWorld.multiplyMatrices(this.parent.matrixWorld,this.matrix)),this.matrixWorldNeedsUpdate=!1,e=!0);let t=this.children;for(let n=0,r=t.length;n<r;n++)t[n].updateMatrixWorld(e)}updateWorldMatrix(e,t,n=!1){let r=this.parent;if(e===!0&&r!==null&&r.updateWorldMatrix(!0,!1),this.matrixAutoUpdate&&this.updateMatrix(),(this.matrixWorldNeedsUpdate||n)&&(this.matrixWorldAutoUpdate===!0&&(this.parent===null?this.matrixWorld.copy(this.matrix):this.matrixWorld.multiplyMatrices(this.parent.matrixWorld,this.matrix)),this.matrixWorldNeedsUpdate=!1,n=!0),t===!0){let s=this.children;for(let o=0,a=s.length;o<a;o++)s[o].updateWorldMatrix(!1,!0,n)}}toJSON(e){let t=e===void 0||typeof e=="string",n={};t&&(e={geometries:{},materials:{},textures:{},images:{},shapes:{},skeletons:{},animations:{},nodes:{}},n.metadata={version:4.7,type:"Object",generator:"Object3D.toJSON"});let r={};r.uuid=this.uuid,r.type=this.type,r.name=this.name,r.castShadow=this.castShadow,r.receiveShadow=this.receiveShadow,r.visible=this.visible,r.frustumCulled=this.frustumCulled,r.renderOrder=this.renderOrder,r.static=this.static,r.matrixAutoUpdate=this.matrixAutoUpdate,Object.keys(this.userData).length>0&&(r.userData=this.userData),r.layers=this.layers.mask,r.matrix=this.matrix.toArray(),r.up=this.up.toArray(),this.pivot!==null&&(r.pivot=this.pivot.toArray()),this.morphTargetDictionary!==void 0&&(r.morphTargetDictionary=Object.assign({},this.morphTargetDictionary)),this.morphTargetInfluences!==void 0&&(r.morphTargetInfluences=this.morphTargetInfluences.slice()),this.isInstancedMesh&&(r.type="InstancedMesh",r.count=this.count,r.instanceMatrix=this.instanceMatrix.toJSON(),this.instanceColor!==null&&(r.instanceColor=this.instanceColor.toJSON())),this.isBatchedMesh&&(r.type="BatchedMesh",r.perObjectFrustumCulled=this.perObjectFrustumCulled,r.sortObjects=this.sortObjects,r.drawRanges=this._drawRanges,r.reservedRanges=this._reservedRanges,r.geometryInfo=this._geometryInfo.map(a=>({...a,boundingBox:a.boundingBox?a.boundingBox.toJSON():void 0,boundingSphere:a.boundingSphere?a.boundingSphere.toJSON():void 0})),r.instanceInfo=this._instanceInfo.map(a=>({...a})),r.availableInstanceIds=this._availableInstanceIds.slice(),r.availableGeometryIds=this._availableGeometryIds.slice(),r.nextIndexStart=this._nextIndexStart,r.nextVertexStart=this._nextVertexStart,r.geometryCount=this._geometryCount,r.maxInstanceCount=this._maxInstanceCount,r.maxVertexCount=this._maxVertexCount,r.maxIndexCount=this._maxIndexCount,r.geometryInitialized=this._geometryInitialized,r.matricesTexture=this._matricesTexture.toJSON(e),r.indirectTexture=this._indirectTexture.toJSON(e),this._colorsTexture!==null&&(r.colorsTexture=this._colorsTexture.toJSON(e)),this.boundingSphere!==null&&(r.boundingSphere=this.boundingSphere.toJSON()),this.boundingBox!==null&&(r.boundingBox=this.boundingBox.toJSON()));function s(a,l){return a[l.uuid]===void 0&&(a[l.uuid]=l.toJSON(e)),l.uuid}if(this.isScene)this.background&&(this.background.isColor?r.background=this.background.toJSON():this.background.isTexture&&(r.background=this.background.toJSON(e).uuid)),this.environment&&this.environment.isTexture&&this.environment.isRenderTargetTexture!==!0&&(r.environment=this.environment.toJSON(e).uuid);else if(this.isMesh||this.isLine||this.isPoints){r.geometry=s(e.geometries,this.geometry);let a=this.geometry.parameters;if(a!==void 0&&a.shapes!==void 0){let l=a.shapes;if(Array.isArray(l))for(let c=0,u=l.length;c<u;c++){let h=l[c];s(e.shapes,h)}else s(e.shapes,l)}}if(this.isSkinnedMesh&&(r.bindMode=this.bindMode,r.bindMatrix=this.bindMatrix.toArray(),this.skeleton!==void 0&&(s(e.skeletons,this.skeleton),r.skeleton=this.skeleton.uuid)),this.material!==void 0)if(Array.isArray(this.material)){let a=[];for(let l=0,c=this.material.length;l<c;l++)a.push(s(e.materials,this.material[l]));r.material=a}else r.material=s(e.materials,this.material);if(this.children.length>0){r.children=[];for(let a=0;a<this.children.length;a++)r.children.push(this.children[a].toJSON(e).object)}if(this.animations.length>0){r.animations=[];for(let a=0;a<this.animations.length;a++){let l=this.animations[a];r.animations.push(s(e.animations,l))}}if(t){let a=o(e.geometries),l=o(e.materials),c=o(e.textures),u=o(e.images),h=o(e.shapes),d=o(e.skeletons),g=o(e.animations),M=o(e.nodes);a.length>0&&(n.geometries=a),l.length>0&&(n.materials=l),c.length>0&&(n.textures=c),u.length>0&&(n.images=u),h.length>0&&(n.shapes=h),d.length>0&&(n.skeletons=d),g.length>0&&(n.animations=g),M.length>0&&(n.nodes=M)}return n.object=r,n;function o(a){let l=[];for(let c in a){let u=a[c];delete u.metadata,l.push(u)}return l}}clone(e){return new this.constructor().copy(this,e)}copy(e,t=!0){if(this.name=e.name,this.up.copy(e.up),this.position.copy(e.position),this.rotation.order=e.rotation.order,this.quaternion.copy(e.quaternion),this.scale.copy(e.scale),this.pivot=e.pivot!==null?e.pivot.clone():null,this.matrix.copy(e.matrix),this.matrixWorld.copy(e.matrixWorld),this.matrixAutoUpdate=e.matrixAutoUpdate,this.matrixWorldAutoUpdate=e.matrixWorldAutoUpdate,this.matrixWorldNeedsUpdate=e.matrixWorldNeedsUpdate,this.layers.mask=e.layers.mask,this.visible=e.visible,this.castShadow=e.castShadow,this.receiveShadow=e.receiveShadow,this.frustumCulled=e.frustumCulled,this.renderOrder=e.renderOrder,this.static=e.static,this.animations=e.animations.slice(),this.userData=JSON.parse(JSON.stringify(e.userData)),t===!0)for(let n=0;n<e.children.length;n++){let r=e.children[n];this.add(r.clone())}return this}dispose(){this.dispatchEvent({type:"dispose"})}};Vt.DEFAULT_UP=new I(0,1,0);Vt.DEFAULT_MATRIX_AUTO_UPDATE=!0;Vt.DEFAULT_MATRIX_WORLD_AUTO_UPDATE=!0;var vi=class extends Vt{constructor(){super(),this.isGroup=!0,this.type="Group"}};var Tx={type:"move"},as=class{constructor(){this._targetRay=null,this._grip=null,this._hand=null}getHandSpace(){return this._hand===null&&(this._hand=new vi,this._hand.matrixAutoUpdate=!1,this._hand.visible=!1,this._hand.joints={},this._hand.inputState={pinching:!1}),this._hand}getTargetRaySpace(){return this._targetRay===null&&(this._targetRay=new vi,this._targetRay.matrixAutoUpdate=!1,this._targetRay.visible=!1,this._targetRay.hasLinearVelocity=!1,this._targetRay.linearVelocity=new I,this._targetRay.hasAngularVelocity=!1,this._targetRay.angularVelocity=new I),this._targetRay}getGripSpace(){return this._grip===null&&(this._grip=new vi,this._grip.matrixAutoUpdate=!1,this._grip.visible=!1,this._grip.hasLinearVelocity=!1,this._grip.linearVelocity=new I,this._grip.hasAngularVelocity=!1,this._grip.angularVelocity=new I,this._grip.eventsEnabled=!1),this._grip}dispatchEvent(e){return this._targetRay!==null&&this._targetRay.dispatchEvent(e),this._grip!==null&&this._grip.dispatchEvent(e),this._hand!==null&&this._hand.dispatchEvent(e),this}connect(e){if(e&&e.hand){let t=this._hand;if(t)for(let n of e.hand.values())this._getHandJoint(t,n)}return this.dispatchEvent({type:"connected",data:e}),this}disconnect(e){return this.dispatchEvent({type:"disconnected",data:e}),this._targetRay!==null&&(this._targetRay.visible=!1),this._grip!==null&&(this._grip.visible=!1),this._hand!==null&&(this._hand.visible=!1),this}update(e,t,n){let r=null,s=null,o=null,a=this._targetRay,l=this._grip,c=this._hand;if(e&&t.session.visibilityState!=="visible-blurred"){if(c&&e.hand){o=!0;for(let S of e.hand.values()){let _=t.getJointPose(S,n),m=this._getHandJoint(c,S);_!==null&&(m.matrix.fromArray(_.transform.matrix),m.matrix.decompose(m.position,m.quaternion,m.scale),m.matrixWorldNeedsUpdate=!0,m.jointRadius=_.radius),m.visible=_!==null}let u=c.joints["index-finger-tip"],h=c.joints["thumb-tip"],d=u.position.distanceTo(h.position),g=.02,M=.005;c.inputState.pinching&&d>g+M?(c.inputState.pinching=!1,this.dispatchEvent({type:"pinchend",handedness:e.handedness,target:this})):!c.inputState.pinching&&d<=g-M&&(c.inputState.pinching=!0,this.dispatchEvent({type:"pinchstart",handedness:e.handedness,target:this}))}else l!==null&&e.gripSpace&&(s=t.getPose(e.gripSpace,n),s!==null&&(l.matrix.fromArray(s.transform.matrix),l.matrix.decompose(l.position,l.quaternion,l.scale),l.matrixWorldNeedsUpdate=!0,s.linearVelocity?(l.hasLinearVelocity=!0,l.linearVelocity.copy(s.linearVelocity)):l.hasLinearVelocity=!1,s.angularVelocity?(l.hasAngularVelocity=!0,l.angularVelocity.copy(s.angularVelocity)):l.hasAngularVelocity=!1,l.eventsEnabled&&l.dispatchEvent({type:"gripUpdated",data:e,target:this})));a!==null&&(r=t.getPose(e.targetRaySpace,n),r===null&&s!==null&&(r=s),r!==null&&(a.matrix.fromArray(r.transform.matrix),a.matrix.decompose(a.position,a.quaternion,a.scale),a.matrixWorldNeedsUpdate=!0,r.linearVelocity?(a.hasLinearVelocity=!0,a.linearVelocity.copy(r.linearVelocity)):a.hasLinearVelocity=!1,r.angularVelocity?(a.hasAngularVelocity=!0,a.angularVelocity.copy(r.angularVelocity)):a.hasAngularVelocity=!1,this.dispatchEvent(Tx)))}return a!==null&&(a.visible=r!==null),l!==null&&(l.visible=s!==null),c!==null&&(c.visible=o!==null),this}_getHandJoint(e,t){if(e.joints[t.jointName]===void 0){let n=new vi;n.matrixAutoUpdate=!1,n.visible=!1,e.joints[t.jointName]=n,e.add(n)}return e.joints[t.jointName]}};var Ff={aliceblue:15792383,antiquewhite:16444375,aqua:65535,aquamarine:8388564,azure:15794175,beige:16119260,bisque:16770244,black:0,blanchedalmond:16772045,blue:255,blueviolet:9055202,brown:10824234,burlywood:14596231,cadetblue:6266528,chartreuse:8388352,chocolate:13789470,coral:16744272,cornflowerblue:6591981,cornsilk:16775388,crimson:14423100,cyan:65535,darkblue:139,darkcyan:35723,darkgoldenrod:12092939,darkgray:11119017,darkgreen:25600,darkgrey:11119017,darkkhaki:12433259,darkmagenta:9109643,darkolivegreen:5597999,darkorange:16747520,darkorchid:10040012,darkred:9109504,darksalmon:15308410,darkseagreen:9419919,darkslateblue:4734347,darkslategray:3100495,darkslategrey:3100495,darkturquoise:52945,darkviolet:9699539,deeppink:16716947,deepskyblue:49151,dimgray:6908265,dimgrey:6908265,dodgerblue:2003199,firebrick:11674146,floralwhite:16775920,forestgreen:2263842,fuchsia:16711935,gainsboro:14474460,ghostwhite:16316671,gold:16766720,goldenrod:14329120,gray:8421504,green:32768,greenyellow:11403055,grey:8421504,honeydew:15794160,hotpink:16738740,indianred:13458524,indigo:4915330,ivory:16777200,khaki:15787660,lavender:15132410,lavenderblush:16773365,lawngreen:8190976,lemonchiffon:16775885,lightblue:11393254,lightcoral:15761536,lightcyan:14745599,lightgoldenrodyellow:16448210,lightgray:13882323,lightgreen:9498256,lightgrey:13882323,lightpink:16758465,lightsalmon:16752762,lightseagreen:2142890,lightskyblue:8900346,lightslategray:7833753,lightslategrey:7833753,lightsteelblue:11584734,lightyellow:16777184,lime:65280,limegreen:3329330,linen:16445670,magenta:16711935,maroon:8388608,mediumaquamarine:6737322,mediumblue:205,mediumorchid:12211667,mediumpurple:9662683,mediumseagreen:3978097,mediumslateblue:8087790,mediumspringgreen:64154,mediumturquoise:4772300,mediumvioletred:13047173,midnightblue:1644912,mintcream:16121850,mistyrose:16770273,moccasin:16770229,navajowhite:16768685,navy:128,oldlace:16643558,olive:8421376,olivedrab:7048739,orange:16753920,orangered:16729344,orchid:14315734,palegoldenrod:15657130,palegreen:10025880,paleturquoise:11529966,palevioletred:14381203,papayawhip:16773077,peachpuff:16767673,peru:13468991,pink:16761035,plum:14524637,powderblue:11591910,purple:8388736,rebeccapurple:6697881,red:16711680,rosybrown:12357519,royalblue:4286945,saddlebrown:9127187,salmon:16416882,sandybrown:16032864,seagreen:3050327,seashell:16774638,sienna:10506797,silver:12632256,skyblue:8900331,slateblue:6970061,slategray:7372944,slategrey:7372944,snow:16775930,springgreen:65407,steelblue:4620980,tan:13808780,teal:32896,thistle:14204888,tomato:16737095,turquoise:4251856,violet:15631086,wheat:16113331,white:16777215,whitesmoke:16119285,yellow:16776960,yellowgreen:10145074},tr={h:0,s:0,l:0},Ia={h:0,s:0,l:0};function bc(i,e,t){return t<0&&(t+=1),t>1&&(t-=1),t<1/6?i+(e-i)*6*t:t<1/2?e:t<2/3?i+(e-i)*6*(2/3-t):i}var $e=class{constructor(e,t,n){return this.isColor=!0,this.r=1,this.g=1,this.b=1,this.set(e,t,n)}set(e,t,n){if(t===void 0&&n===void 0){let r=e;r&&r.isColor?this.copy(r):typeof r=="number"?this.setHex(r):typeof r=="string"&&this.setStyle(r)}else this.setRGB(e,t,n);return this}setScalar(e){return this.r=e,this.g=e,this.b=e,this}setHex(e,t=Ci){return e=Math.floor(e),this.r=(e>>16&255)/255,this.g=(e>>8&255)/255,this.b=(e&255)/255,je.colorSpaceToWorking(this,t),this}setRGB(e,t,n,r=je.workingColorSpace){return this.r=e,this.g=t,this.b=n,je.colorSpaceToWorking(this,r),this}setHSL(e,t,n,r=je.workingColorSpace){if(e=Ra(e,1),t=Qe(t,0,1),n=Qe(n,0,1),t===0)this.r=this.g=this.b=n;else{let s=n<=.5?n*(1+t):n+t-n*t,o=2*n-s;this.r=bc(o,s,e+1/3),this.g=bc(o,s,e),this.b=bc(o,s,e-1/3)}return je.colorSpaceToWorking(this,r),this}setStyle(e,t=Ci){function n(s){s!==void 0&&parseFloat(s)<1&&Ce("Color: Alpha component of "+e+" will be ignored.")}let r;if(r=/^(\w+)\(([^\)]*)\)/.exec(e)){let s,o=r[1],a=r[2];switch(o){case"rgb":case"rgba":if(s=/^\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*(?:,\s*(\d+(?:\.\d+)?|\.\d+)\s*)?$/.exec(a))return n(s[4]),this.setRGB(Math.min(255,parseInt(s[1],10))/255,Math.min(255,parseInt(s[2],10))/255,Math.min(255,parseInt(s[3],10))/255,t);if(s=/^\s*(\d+(?:\.\d+)?|\.\d+)\%\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*(?:,\s*(\d+(?:\.\d+)?|\.\d+)\s*)?$/.exec(a))return n(s[4]),this.setRGB(Math.min(100,parseFloat(s[1]))/100,Math.min(100,parseFloat(s[2]))/100,Math.min(100,parseFloat(s[3]))/100,t);break;case"hsl":case"hsla":if(s=/^\s*([+-]?(?:\d+(?:\.\d+)?|\.\d+))\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*(?:,\s*(\d+(?:\.\d+)?|\.\d+)\s*)?$/.exec(a))return n(s[4]),this.setHSL(parseFloat(s[1])/360,parseFloat(s[2])/100,parseFloat(s[3])/100,t);break;default:Ce("Color: Unknown color model "+e)}}else if(r=/^\#([A-Fa-f\d]+)$/.exec(e)){let s=r[1],o=s.length;if(o===3)return this.setRGB(parseInt(s.charAt(0),16)/15,parseInt(s.charAt(1),16)/15,parseInt(s.charAt(2),16)/15,t);if(o===6)return this.setHex(parseInt(s,16),t);Ce("Color: Invalid hex color "+e)}else if(e&&e.length>0)return this.setColorName(e,t);return this}setColorName(e,t=Ci){let n=Ff[e.toLowerCase()];return n!==void 0?this.setHex(n,t):Ce("Color: Unknown color "+e),this}clone(){return new this.constructor(this.r,this.g,this.b)}copy(e){return this.r=e.r,this.g=e.g,this.b=e.b,this}copySRGBToLinear(e){return this.r=un(e.r),this.g=un(e.g),this.b=un(e.b),this}copyLinearToSRGB(e){return this.r=br(e.r),this.g=br(e.g),this.b=br(e.b),this}convertSRGBToLinear(){return this.copySRGBToLinear(this),this}convertLinearToSRGB(){return this.copyLinearToSRGB(this),this}getHex(e=Ci){return je.workingToColorSpace(Si.copy(this),e),Math.round(Qe(Si.r*255,0,255))*65536+Math.round(Qe(Si.g*255,0,255))*256+Math.round(Qe(Si.b*255,0,255))}getHexString(e=Ci){return("000000"+this.getHex(e).toString(16)).slice(-6)}getHSL(e,t=je.workingColorSpace){je.workingToColorSpace(Si.copy(this),t);let n=Si.r,r=Si.g,s=Si.b,o=Math.max(n,r,s),a=Math.min(n,r,s),l,c,u=(a+o)/2;if(a===o)l=0,c=0;else{let h=o-a;switch(c=u<=.5?h/(o+a):h/(2-o-a),o){case n:l=(r-s)/h+(r<s?6:0);break;case r:l=(s-n)/h+2;break;case s:l=(n-r)/h+4;break}l/=6}return e.h=l,e.s=c,e.l=u,e}getRGB(e,t=je.workingColorSpace){return je.workingToColorSpace(Si.copy(this),t),e.r=Si.r,e.g=Si.g,e.b=Si.b,e}getStyle(e=Ci){je.workingToColorSpace(Si.copy(this),e);let t=Si.r,n=Si.g,r=Si.b;return e!==Ci?`color(${e} ${t.toFixed(3)} ${n.toFixed(3)} ${r.toFixed(3)})`:`rgb(${Math.round(t*255)},${Math.round(n*255)},${Math.round(r*255)})`}offsetHSL(e,t,n){return this.getHSL(tr),this.setHSL(tr.h+e,tr.s+t,tr.l+n)}add(e){return this.r+=e.r,this.g+=e.g,this.b+=e.b,this}addColors(e,t){return this.r=e.r+t.r,this.g=e.g+t.g,this.b=e.b+t.b,this}addScalar(e){return this.r+=e,this.g+=e,this.b+=e,this}sub(e){return this.r=Math.max(0,this.r-e.r),this.g=Math.max(0,this.g-e.g),this.b=Math.max(0,this.b-e.b),this}multiply(e){return this.r*=e.r,this.g*=e.g,this.b*=e.b,this}multiplyScalar(e){return this.r*=e,this.g*=e,this.b*=e,this}lerp(e,t){return this.r+=(e.r-this.r)*t,this.g+=(e.g-this.g)*t,this.b+=(e.b-this.b)*t,this}lerpColors(e,t,n){return this.r=e.r+(t.r-e.r)*n,this.g=e.g+(t.g-e.g)*n,this.b=e.b+(t.b-e.b)*n,this}lerpHSL(e,t){this.getHSL(tr),e.getHSL(Ia);let n=ts(tr.h,Ia.h,t),r=ts(tr.s,Ia.s,t),s=ts(tr.l,Ia.l,t);return this.setHSL(n,r,s),this}setFromVector3(e){return this.r=e.x,this.g=e.y,this.b=e.z,this}applyMatrix3(e){let t=this.r,n=this.g,r=this.b,s=e.elements;return this.r=s[0]*t+s[3]*n+s[6]*r,this.g=s[1]*t+s[4]*n+s[7]*r,this.b=s[2]*t+s[5]*n+s[8]*r,this}equals(e){return e.r===this.r&&e.g===this.g&&e.b===this.b}fromArray(e,t=0){return this.r=e[t],this.g=e[t+1],this.b=e[t+2],this}toArray(e=[],t=0){return e[t]=this.r,e[t+1]=this.g,e[t+2]=this.b,e}fromBufferAttribute(e,t){return this.r=e.getX(t),this.g=e.getY(t),this.b=e.getZ(t),this}toJSON(){return this.getHex()}*[Symbol.iterator](){yield this.r,yield this.g,yield this.b}},Si=new $e;$e.NAMES=Ff;var To=class extends Vt{constructor(){super(),this.isScene=!0,this.type="Scene",this.background=null,this.environment=null,this.fog=null,this.backgroundBlurriness=0,this.backgroundIntensity=1,this.backgroundRotation=new Sn,this.environmentIntensity=1,this.environmentRotation=new Sn,this.overrideMaterial=null,typeof __THREE_DEVTOOLS__<"u"&&__THREE_DEVTOOLS__.dispatchEvent(new CustomEvent("observe",{detail:this}))}copy(e,t){return super.copy(e,t),this.background=e.background!==null?e.background.clone():null,this.environment=e.environment!==null?e.environment.clone():null,this.fog=e.fog!==null?e.fog.clone():null,this.backgroundBlurriness=e.backgroundBlurriness,this.backgroundIntensity=e.backgroundIntensity,this.backgroundRotation.copy(e.backgroundRotation),this.environmentIntensity=e.environmentIntensity,this.environmentRotation.copy(e.environmentRotation),this.overrideMaterial=e.overrideMaterial!==null?e.overrideMaterial.clone():null,this.matrixAutoUpdate=e.matrixAutoUpdate,this}toJSON(e){let t=super.toJSON(e);return this.fog!==null&&(t.object.fog=this.fog.toJSON()),t.object.backgroundBlurriness=this.backgroundBlurriness,t.object.backgroundIntensity=this.backgroundIntensity,t.object.backgroundRotation=this.backgroundRotation.toArray(),t.object.environmentIntensity=this.environmentIntensity,t.object.environmentRotation=this.environmentRotation.toArray(),t}};var hn=new I,Bn=new I,Tc=new I,Gn=new I,ls=new I,cs=new I,Df=new I,Ac=new I,Rc=new I,wc=new I,Cc=new vt,Pc=new vt,Fc=new vt,ir=class i{constructor(e=new I,t=new I,n=new I){this.a=e,this.b=t,this.c=n}static getNormal(e,t,n,r){r.subVectors(n,t),hn.subVectors(e,t),r.cross(hn);let s=r.lengthSq();return s>0?r.multiplyScalar(1/Math.sqrt(s)):r.set(0,0,0)}static getBarycoord(e,t,n,r,s){hn.subVectors(r,t),Bn.subVectors(n,t),Tc.subVectors(e,t);let o=hn.dot(hn),a=hn.dot(Bn),l=hn.dot(Tc),c=Bn.dot(Bn),u=Bn.dot(Tc),h=o*c-a*a;if(h===0)return s.set(0,0,0),null;let d=1/h,g=(c*l-a*u)*d,M=(o*u-a*l)*d;return s.set(1-g-M,M,g)}static containsPoint(e,t,n,r){return this.getBarycoord(e,t,n,r,Gn)===null?!1:Gn.x>=0&&Gn.y>=0&&Gn.x+Gn.y<=1}static getInterpolation(e,t,n,r,s,o,a,l){return this.getBarycoord(e,t,n,r,Gn)===null?(l.x=0,l.y=0,"z"in l&&(l.z=0),"w"in l&&(l.w=0),null):(l.setScalar(0),l.addScaledVector(s,Gn.x),l.addScaledVector(o,Gn.y),l.addScaledVector(a,Gn.z),l)}static getInterpolatedAttribute(e,t,n,r,s,o){return Cc.setScalar(0),Pc.setScalar(0),Fc.setScalar(0),Cc.fromBufferAttribute(e,t),Pc.fromBufferAttribute(e,n),Fc.fromBufferAttribute(e,r),o.setScalar(0),o.addScaledVector(Cc,s.x),o.addScaledVector(Pc,s.y),o.addScaledVector(Fc,s.z),o}static isFrontFacing(e,t,n,r){return hn.subVectors(n,t),Bn.subVectors(e,t),hn.cross(Bn).dot(r)<0}set(e,t,n){return this.a.copy(e),this.b.copy(t),this.c.copy(n),this}setFromPointsAndIndices(e,t,n,r){return this.a.copy(e[t]),this.b.copy(e[n]),this.c.copy(e[r]),this}setFromAttributeAndIndices(e,t,n,r){return this.a.fromBufferAttribute(e,t),this.b.fromBufferAttribute(e,n),this.c.fromBufferAttribute(e,r),this}clone(){return new this.constructor().copy(this)}copy(e){return this.a.copy(e.a),this.b.copy(e.b),this.c.copy(e.c),this}getArea(){return hn.subVectors(this.c,this.b),Bn.subVectors(this.a,this.b),hn.cross(Bn).length()*.5}getMidpoint(e){return e.addVectors(this.a,this.b).add(this.c).multiplyScalar(1/3)}getNormal(e){return i.getNormal(this.a,this.b,this.c,e)}getPlane(e){return e.setFromCoplanarPoints(this.a,this.b,this.c)}getBarycoord(e,t){return i.getBarycoord(e,this.a,this.b,this.c,t)}getInterpolation(e,t,n,r,s){return i.getInterpolation(e,this.a,this.b,this.c,t,n,r,s)}containsPoint(e){return i.containsPoint(e,this.a,this.b,this.c)}isFrontFacing(e){return i.isFrontFacing(this.a,this.b,this.c,e)}intersectsBox(e){return e.intersectsTriangle(this)}closestPointToPoint(e,t){let n=this.a,r=this.b,s=this.c,o,a;ls.subVectors(r,n),cs.subVectors(s,n),Ac.subVectors(e,n);let l=ls.dot(Ac),c=cs.dot(Ac);if(l<=0&&c<=0)return t.copy(n);Rc.subVectors(e,r);let u=ls.dot(Rc),h=cs.dot(Rc);if(u>=0&&h<=u)return t.copy(r);let d=l*h-u*c;if(d<=0&&l>=0&&u<=0&&l-u>0)return o=l/(l-u),t.copy(n).addScaledVector(ls,o);wc.subVectors(e,s);let g=ls.dot(wc),M=cs.dot(wc);if(M>=0&&g<=M)return t.copy(s);let S=g*c-l*M;if(S<=0&&c>=0&&M<=0)return a=c/(c-M),t.copy(n).addScaledVector(cs,a);let _=u*M-g*h;if(_<=0&&h-u>=0&&g-M>=0)return Df.subVectors(s,r),a=(h-u)/(h-u+(g-M)),t.copy(r).addScaledVector(Df,a);let m=1/(_+S+d);return o=S*m,a=d*m,t.copy(n).addScaledVector(ls,o).addScaledVector(cs,a)}equals(e){return e.a.equals(this.a)&&e.b.equals(this.b)&&e.c.equals(this.c)}};var Xi=class{constructor(e=new I(1/0,1/0,1/0),t=new I(-1/0,-1/0,-1/0)){this.isBox3=!0,this.min=e,this.max=t}set(e,t){return this.min.copy(e),this.max.copy(t),this}setFromArray(e){this.makeEmpty();for(let t=0,n=e.length;t<n;t+=3)this.expandByPoint(dn.fromArray(e,t));return this}setFromBufferAttribute(e){this.makeEmpty();for(let t=0,n=e.count;t<n;t++)this.expandByPoint(dn.fromBufferAttribute(e,t));return this}setFromPoints(e){this.makeEmpty();for(let t=0,n=e.length;t<n;t++)this.expandByPoint(e[t]);return this}setFromCenterAndSize(e,t){let n=dn.copy(t).multiplyScalar(.5);return this.min.copy(e).sub(n),this.max.copy(e).add(n),this}setFromObject(e,t=!1){return this.makeEmpty(),this.expandByObject(e,t)}clone(){return new this.constructor().copy(this)}copy(e){return this.min.copy(e.min),this.max.copy(e.max),this}makeEmpty(){return this.min.x=this.min.y=this.min.z=1/0,this.max.x=this.max.y=this.max.z=-1/0,this}isEmpty(){return this.max.x<this.min.x||this.max.y<this.min.y||this.max.z<this.min.z}getCenter(e){return this.isEmpty()?e.set(0,0,0):e.addVectors(this.min,this.max).multiplyScalar(.5)}getSize(e){return this.isEmpty()?e.set(0,0,0):e.subVectors(this.max,this.min)}expandByPoint(e){return this.min.min(e),this.max.max(e),this}expandByVector(e){return this.min.sub(e),this.max.add(e),this}expandByScalar(e){return this.min.addScalar(-e),this.max.addScalar(e),this}expandByObject(e,t=!1){e.updateWorldMatrix(!1,!1);let n=e.geometry;if(n!==void 0){let s=n.getAttribute("position");if(t===!0&&s!==void 0&&e.isInstancedMesh!==!0&&e.isBatchedMesh!==!0)for(let o=0,a=s.count;o<a;o++)e.isMesh===!0?e.getVertexPosition(o,dn):dn.fromBufferAttribute(s,o),dn.applyMatrix4(e.matrixWorld),this.expandByPoint(dn);else e.boundingBox!==void 0?(e.boundingBox===null&&e.computeBoundingBox(),Oa.copy(e.boundingBox)):(n.boundingBox===null&&n.computeBoundingBox(),Oa.copy(n.boundingBox)),Oa.applyMatrix4(e.matrixWorld),this.union(Oa)}let r=e.children;for(let s=0,o=r.length;s<o;s++)this.expandByObject(r[s],t);return this}containsPoint(e){return e.x>=this.min.x&&e.x<=this.max.x&&e.y>=this.min.y&&e.y<=this.max.y&&e.z>=this.min.z&&e.z<=this.max.z}containsBox(e){return this.min.x<=e.min.x&&e.max.x<=this.max.x&&this.min.y<=e.min.y&&e.max.y<=this.max.y&&this.min.z<=e.min.z&&e.max.z<=this.max.z}getParameter(e,t){return t.set((e.x-this.min.x)/(this.max.x-this.min.x),(e.y-this.min.y)/(this.max.y-this.min.y),(e.z-this.min.z)/(this.max.z-this.min.z))}intersectsBox(e){return e.max.x>=this.min.x&&e.min.x<=this.max.x&&e.max.y>=this.min.y&&e.min.y<=this.max.y&&e.max.z>=this.min.z&&e.min.z<=this.max.z}intersectsSphere(e){return this.clampPoint(e.center,dn),dn.distanceToSquared(e.center)<=e.radius*e.radius}intersectsPlane(e){let t,n;return e.normal.x>0?(t=e.normal.x*this.min.x,n=e.normal.x*this.max.x):(t=e.normal.x*this.max.x,n=e.normal.x*this.min.x),e.normal.y>0?(t+=e.normal.y*this.min.y,n+=e.normal.y*this.max.y):(t+=e.normal.y*this.max.y,n+=e.normal.y*this.min.y),e.normal.z>0?(t+=e.normal.z*this.min.z,n+=e.normal.z*this.max.z):(t+=e.normal.z*this.max.z,n+=e.normal.z*this.min.z),t<=-e.constant&&n>=-e.constant}intersectsTriangle(e){if(this.isEmpty())return!1;this.getCenter(Ao),Na.subVectors(this.max,Ao),us.subVectors(e.a,Ao),fs.subVectors(e.b,Ao),hs.subVectors(e.c,Ao),nr.subVectors(fs,us),rr.subVectors(hs,fs),Tr.subVectors(us,hs);let t=[0,-nr.z,nr.y,0,-rr.z,rr.y,0,-Tr.z,Tr.y,nr.z,0,-nr.x,rr.z,0,-rr.x,Tr.z,0,-Tr.x,-nr.y,nr.x,0,-rr.y,rr.x,0,-Tr.y,Tr.x,0];return!Dc(t,us,fs,hs,Na)||(t=[1,0,0,0,1,0,0,0,1],!Dc(t,us,fs,hs,Na))?!1:(Ba.crossVectors(nr,rr),t=[Ba.x,Ba.y,Ba.z],Dc(t,us,fs,hs,Na))}clampPoint(e,t){return t.copy(e).clamp(this.min,this.max)}distanceToPoint(e){return this.clampPoint(e,dn).distanceTo(e)}getBoundingSphere(e){return this.isEmpty()?e.makeEmpty():(this.getCenter(e.center),e.radius=this.getSize(dn).length()*.5),e}intersect(e){return this.min.max(e.min),this.max.min(e.max),this.isEmpty()&&this.makeEmpty(),this}union(e){return this.min.min(e.min),this.max.max(e.max),this}applyMatrix4(e){return this.isEmpty()?this:(zn[0].set(this.min.x,this.min.y,this.min.z).applyMatrix4(e),zn[1].set(this.min.x,this.min.y,this.max.z).applyMatrix4(e),zn[2].set(this.min.x,this.max.y,this.min.z).applyMatrix4(e),zn[3].set(this.min.x,this.max.y,this.max.z).applyMatrix4(e),zn[4].set(this.max.x,this.min.y,this.min.z).applyMatrix4(e),zn[5].set(this.max.x,this.min.y,this.max.z).applyMatrix4(e),zn[6].set(this.max.x,this.max.y,this.min.z).applyMatrix4(e),zn[7].set(this.max.x,this.max.y,this.max.z).applyMatrix4(e),this.setFromPoints(zn),this)}translate(e){return this.min.add(e),this.max.add(e),this}equals(e){return e.min.equals(this.min)&&e.max.equals(this.max)}toJSON(){return{min:this.min.toArray(),max:this.max.toArray()}}fromJSON(e){return this.min.fromArray(e.min),this.max.fromArray(e.max),this}},zn=[new I,new I,new I,new I,new I,new I,new I,new I],dn=new I,Oa=new Xi,us=new I,fs=new I,hs=new I,nr=new I,rr=new I,Tr=new I,Ao=new I,Na=new I,Ba=new I,Ar=new I;function Dc(i,e,t,n,r){for(let s=0,o=i.length-3;s<=o;s+=3){Ar.fromArray(i,s);let a=r.x*Math.abs(Ar.x)+r.y*Math.abs(Ar.y)+r.z*Math.abs(Ar.z),l=e.dot(Ar),c=t.dot(Ar),u=n.dot(Ar);if(Math.max(-Math.max(l,c,u),Math.min(l,c,u))>a)return!1}return!0}var qt=new I,Ga=new Oe,Ax=0,ni=class extends ii{constructor(e,t,n=!1){if(super(),Array.isArray(e))throw new TypeError("THREE.BufferAttribute: array should be a Typed Array.");this.isBufferAttribute=!0,Object.defineProperty(this,"id",{value:Ax++}),this.name="",this.array=e,this.itemSize=t,this.count=e!==void 0?e.length/t:0,this.normalized=n,this.usage=df,this.updateRanges=[],this.gpuType=fi,this.version=0,this._normalizationScale=e!==void 0?wa(e):void 0}onUploadCallback(){}set needsUpdate(e){e===!0&&this.version++}setUsage(e){return this.usage=e,this}addUpdateRange(e,t){this.updateRanges.push({start:e,count:t})}clearUpdateRanges(){this.updateRanges.length=0}copy(e){return this.name=e.name,this.array=new e.array.constructor(e.array),this.itemSize=e.itemSize,this.count=e.count,this.normalized=e.normalized,this.usage=e.usage,this.gpuType=e.gpuType,this._normalizationScale=e._normalizationScale,this}copyAt(e,t,n){e*=this.itemSize,n*=t.itemSize;for(let r=0,s=this.itemSize;r<s;r++)this.array[e+r]=t.array[n+r];return this}copyArray(e){return this.array.set(e),this}applyMatrix3(e){if(this.itemSize===2)for(let t=0,n=this.count;t<n;t++)Ga.fromBufferAttribute(this,t),Ga.applyMatrix3(e),this.setXY(t,Ga.x,Ga.y);else if(this.itemSize===3)for(let t=0,n=this.count;t<n;t++)qt.fromBufferAttribute(this,t),qt.applyMatrix3(e),this.setXYZ(t,qt.x,qt.y,qt.z);return this}applyMatrix4(e){for(let t=0,n=this.count;t<n;t++)qt.fromBufferAttribute(this,t),qt.applyMatrix4(e),this.setXYZ(t,qt.x,qt.y,qt.z);return this}applyNormalMatrix(e){for(let t=0,n=this.count;t<n;t++)qt.fromBufferAttribute(this,t),qt.applyNormalMatrix(e),this.setXYZ(t,qt.x,qt.y,qt.z);return this}transformDirection(e){for(let t=0,n=this.count;t<n;t++)qt.fromBufferAttribute(this,t),qt.transformDirection(e),this.setXYZ(t,qt.x,qt.y,qt.z);return this}set(e,t=0){return this.array.set(e,t),this}getComponent(e,t){let n=this.array[e*this.itemSize+t];return this.normalized&&(n=this._denormalize(n)),n}setComponent(e,t,n){return this.normalized&&(n=this._normalize(n)),this.array[e*this.itemSize+t]=n,this}getX(e){let t=this.array[e*this.itemSize];return this.normalized&&(t=this._denormalize(t)),t}setX(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize]=t,this}getY(e){let t=this.array[e*this.itemSize+1];return this.normalized&&(t=this._denormalize(t)),t}setY(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize+1]=t,this}getZ(e){let t=this.array[e*this.itemSize+2];return this.normalized&&(t=this._denormalize(t)),t}setZ(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize+2]=t,this}getW(e){let t=this.array[e*this.itemSize+3];return this.normalized&&(t=this._denormalize(t)),t}setW(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize+3]=t,this}setXY(e,t,n){return e*=this.itemSize,this.normalized&&(t=this._normalize(t),n=this._normalize(n)),this.array[e+0]=t,this.array[e+1]=n,this}setXYZ(e,t,n,r){return e*=this.itemSize,this.normalized&&(t=this._normalize(t),n=this._normalize(n),r=this._normalize(r)),this.array[e+0]=t,this.array[e+1]=n,this.array[e+2]=r,this}setXYZW(e,t,n,r,s){return e*=this.itemSize,this.normalized&&(t=this._normalize(t),n=this._normalize(n),r=this._normalize(r),s=this._normalize(s)),this.array[e+0]=t,this.array[e+1]=n,this.array[e+2]=r,this.array[e+3]=s,this}onUpload(e){return this.onUploadCallback=e,this}clone(){return new this.constructor(this.array,this.itemSize).copy(this)}toJSON(){let e={itemSize:this.itemSize,type:this.array.constructor.name,array:Array.from(this.array),normalized:this.normalized};return e.name=this.name,e.usage=this.usage,e.gpuType=this.gpuType,e}dispose(){this.dispatchEvent({type:"dispose"})}_denormalize(e){let t=this._normalizationScale;return t!==void 0?Math.max(e/t,-1):dc(e,this.array)}_normalize(e){let t=this._normalizationScale;return t!==void 0?Math.round(e*t):pc(e,this.array)}};var ds=class extends ni{constructor(e,t,n){super(new Uint16Array(e),t,n)}};var ps=class extends ni{constructor(e,t,n){super(new Uint32Array(e),t,n)}};var Ft=class extends ni{constructor(e,t,n){super(new Float32Array(e),t,n)}};var Rx=new Xi,Ro=new I,Lc=new I,Qi=class{constructor(e=new I,t=-1){this.isSphere=!0,this.center=e,this.radius=t}set(e,t){return this.center.copy(e),this.radius=t,this}setFromPoints(e,t){let n=this.center;t!==void 0?n.copy(t):Rx.setFromPoints(e).getCenter(n);let r=0;for(let s=0,o=e.length;s<o;s++)r=Math.max(r,n.distanceToSquared(e[s]));return this.radius=Math.sqrt(r),this}copy(e){return this.center.copy(e.center),this.radius=e.radius,this}isEmpty(){return this.radius<0}makeEmpty(){return this.center.set(0,0,0),this.radius=-1,this}containsPoint(e){return e.distanceToSquared(this.center)<=this.radius*this.radius}distanceToPoint(e){return e.distanceTo(this.center)-this.radius}intersectsSphere(e){let t=this.radius+e.radius;return e.center.distanceToSquared(this.center)<=t*t}intersectsBox(e){return e.intersectsSphere(this)}intersectsPlane(e){return Math.abs(e.distanceToPoint(this.center))<=this.radius}clampPoint(e,t){let n=this.center.distanceToSquared(e);return t.copy(e),n>this.radius*this.radius&&(t.sub(this.center).normalize(),t.multiplyScalar(this.radius).add(this.center)),t}getBoundingBox(e){return this.isEmpty()?(e.makeEmpty(),e):(e.set(this.center,this.center),e.expandByScalar(this.radius),e)}applyMatrix4(e){return this.center.applyMatrix4(e),this.radius=this.radius*e.getMaxScaleOnAxis(),this}translate(e){return this.center.add(e),this}expandByPoint(e){if(this.isEmpty())return this.center.copy(e),this.radius=0,this;Ro.subVectors(e,this.center);let t=Ro.lengthSq();if(t>this.radius*this.radius){let n=Math.sqrt(t),r=(n-this.radius)*.5;this.center.addScaledVector(Ro,r/n),this.radius+=r}return this}union(e){return e.isEmpty()?this:this.isEmpty()?(this.copy(e),this):(this.center.equals(e.center)===!0?this.radius=Math.max(this.radius,e.radius):(Lc.subVectors(e.center,this.center).setLength(e.radius),this.expandByPoint(Ro.copy(e.center).add(Lc)),this.expandByPoint(Ro.copy(e.center).sub(Lc))),this)}equals(e){return e.center.equals(this.center)&&e.radius===this.radius}clone(){return new this.constructor().copy(this)}toJSON(){return{radius:this.radius,center:this.center.toArray()}}fromJSON(e){return this.radius=e.radius,this.center.fromArray(e.center),this}};var wx=0,en=new tt,Uc=new Vt,ms=new I,qi=new Xi,wo=new Xi,ri=new I,Et=class i extends ii{constructor(){super(),this.isBufferGeometry=!0,Object.defineProperty(this,"id",{value:wx++}),this.uuid=cn(),this.name="",this.type="BufferGeometry",this.index=null,this.indirect=null,this.indirectOffset=0,this.attributes={},this.morphAttributes={},this.morphTargetsRelative=!1,this.groups=[],this.boundingBox=null,this.boundingSphere=null,this.drawRange={start:0,count:1/0},this.userData={},this._transformed=!1}getIndex(){return this.index}setIndex(e){return Array.isArray(e)?this.index=new(mf(e)?ps:ds)(e,1):this.index=e,this}setIndirect(e,t=0){return this.indirect=e,this.indirectOffset=t,this}getIndirect(){return this.indirect}getAttribute(e){return this.attributes[e]}setAttribute(e,t){return this.attributes[e]=t,this}deleteAttribute(e){return delete this.attributes[e],this}hasAttribute(e){return this.attributes[e]!==void 0}addGroup(e,t,n=0){this.groups.push({start:e,count:t,materialIndex:n})}clearGroups(){this.groups=[]}setDrawRange(e,t){this.drawRange.start=e,this.drawRange.count=t}applyMatrix4(e){let t=this.attributes.position;t!==void 0&&(t.applyMatrix4(e),t.needsUpdate=!0);let n=this.attributes.normal;if(n!==void 0){let s=new ke().getNormalMatrix(e);n.applyNormalMatrix(s),n.needsUpdate=!0}let r=this.attributes.tangent;return r!==void 0&&(r.transformDirection(e),r.needsUpdate=!0),this.boundingBox!==null&&this.computeBoundingBox(),this.boundingSphere!==null&&this.computeBoundingSphere(),this._transformed=!0,this}applyQuaternion(e){return en.makeRotationFromQuaternion(e),this.applyMatrix4(en),this}rotateX(e){return en.makeRotationX(e),this.applyMatrix4(en),this}rotateY(e){return en.makeRotationY(e),this.applyMatrix4(en),this}rotateZ(e){return en.makeRotationZ(e),this.applyMatrix4(en),this}translate(e,t,n){return en.makeTranslation(e,t,n),this.applyMatrix4(en),this}scale(e,t,n){return en.makeScale(e,t,n),this.applyMatrix4(en),this}lookAt(e){return Uc.lookAt(e),Uc.updateMatrix(),this.applyMatrix4(Uc.matrix),this}center(){return this.computeBoundingBox(),this.boundingBox.getCenter(ms).negate(),this.translate(ms.x,ms.y,ms.z),this}setFromPoints(e){let t=this.getAttribute("position");if(t===void 0){let n=[];for(let r=0,s=e.length;r<s;r++){let o=e[r];n.push(o.x,o.y,o.z||0)}this.setAttribute("position",new Ft(n,3))}else{let n=Math.min(e.length,t.count);for(let r=0;r<n;r++){let s=e[r];t.setXYZ(r,s.x,s.y,s.z||0)}e.length>t.count&&Ce("BufferGeometry: Buffer size too small for points data. Use .dispose() and create a new geometry."),t.needsUpdate=!0}return this}computeBoundingBox(){this.boundingBox===null&&(this.boundingBox=new Xi);let e=this.attributes.position,t=this.morphAttributes.position;if(e&&e.isGLBufferAttribute){ot("BufferGeometry.computeBoundingBox(): GLBufferAttribute requires a manual bounding box.",this),this.boundingBox.set(new I(-1/0,-1/0,-1/0),new I(1/0,1/0,1/0));return}if(e!==void 0){if(this.boundingBox.setFromBufferAttribute(e),t)for(let n=0,r=t.length;n<r;n++){let s=t[n];qi.setFromBufferAttribute(s),this.morphTargetsRelative?(ri.addVectors(this.boundingBox.min,qi.min),this.boundingBox.expandByPoint(ri),ri.addVectors(this.boundingBox.max,qi.max),this.boundingBox.expandByPoint(ri)):(this.boundingBox.expandByPoint(qi.min),this.boundingBox.expandByPoint(qi.max))}}else this.boundingBox.makeEmpty();(isNaN(this.boundingBox.min.x)||isNaN(this.boundingBox.min.y)||isNaN(this.boundingBox.min.z))&&ot('BufferGeometry.computeBoundingBox(): Computed min/max have NaN values. The "position" attribute is likely to have NaN values.',this)}computeBoundingSphere(){this.boundingSphere===null&&(this.boundingSphere=new Qi);let e=this.attributes.position,t=this.morphAttributes.position;if(e&&e.isGLBufferAttribute){ot("BufferGeometry.computeBoundingSphere(): GLBufferAttribute requires a manual bounding sphere.",this),this.boundingSphere.set(new I,1/0);return}if(e){let n=this.boundingSphere.center;if(qi.setFromBufferAttribute(e),t)for(let s=0,o=t.length;s<o;s++){let a=t[s];wo.setFromBufferAttribute(a),this.morphTargetsRelative?(ri.addVectors(qi.min,wo.min),qi.expandByPoint(ri),ri.addVectors(qi.max,wo.max),qi.expandByPoint(ri)):(qi.expandByPoint(wo.min),qi.expandByPoint(wo.max))}qi.getCenter(n);let r=0;for(let s=0,o=e.count;s<o;s++)ri.fromBufferAttribute(e,s),r=Math.max(r,n.distanceToSquared(ri));if(t)for(let s=0,o=t.length;s<o;s++){let a=t[s],l=this.morphTargetsRelative;for(let c=0,u=a.count;c<u;c++)ri.fromBufferAttribute(a,c),l&&(ms.fromBufferAttribute(e,c),ri.add(ms)),r=Math.max(r,n.distanceToSquared(ri))}this.boundingSphere.radius=Math.sqrt(r),isNaN(this.boundingSphere.radius)&&ot('BufferGeometry.computeBoundingSphere(): Computed radius is NaN. The "position" attribute is likely to have NaN values.',this)}}computeTangents(){let e=this.index,t=this.attributes;if(e===null||t.position===void 0||t.normal===void 0||t.uv===void 0){ot("BufferGeometry: .computeTangents() failed. Missing required attributes (index, position, normal or uv)");return}let n=t.position,r=t.normal,s=t.uv,o=this.getAttribute("tangent");(o===void 0||o.count!==n.count)&&(o=new ni(new Float32Array(4*n.count),4),this.setAttribute("tangent",o));let a=[],l=[],c=new Uint8Array(n.count);for(let V=0;V<n.count;V++)a[V]=new I,l[V]=new I;let u=new I,h=new I,d=new I,g=new Oe,M=new Oe,S=new Oe,_=new I,m=new I;function b(V,N,G){c[V]=c[N]=c[G]=1,u.fromBufferAttribute(n,V),h.fromBufferAttribute(n,N),d.fromBufferAttribute(n,G),g.fromBufferAttribute(s,V),M.fromBufferAttribute(s,N),S.fromBufferAttribute(s,G),h.sub(u),d.sub(u),M.sub(g),S.sub(g);let W=1/(M.x*S.y-S.x*M.y);isFinite(W)&&(_.copy(h).multiplyScalar(S.y).addScaledVector(d,-M.y).multiplyScalar(W),m.copy(d).multiplyScalar(M.x).addScaledVector(h,-S.x).multiplyScalar(W),a[V].add(_),a[N].add(_),a[G].add(_),l[V].add(m),l[N].add(m),l[G].add(m))}let w=this.groups;w.length===0&&(w=[{start:0,count:e.count}]);for(let V=0,N=w.length;V<N;++V){let G=w[V],W=G.start,ee=G.count;for(let U=W,$=W+ee;U<$;U+=3)b(e.getX(U+0),e.getX(U+1),e.getX(U+2))}let R=new I,P=new I,C=new I,x=new I;function A(V){C.fromBufferAttribute(r,V),x.copy(C);let N=a[V];R.copy(N),R.sub(C.multiplyScalar(C.dot(N))).normalize(),P.crossVectors(x,N);let W=P.dot(l[V])<0?-1:1;o.setXYZW(V,R.x,R.y,R.z,W)}for(let V=0,N=n.count;V<N;++V)c[V]&&A(V);this._transformed=!0}computeVertexNormals(){let e=this.index,t=this.getAttribute("position");if(t!==void 0){let n=this.getAttribute("normal");if(n===void 0||n.count!==t.count)n=new ni(new Float32Array(t.count*3),3),this.setAttribute("normal",n);else for(let d=0,g=n.count;d<g;d++)n.setXYZ(d,0,0,0);let r=new I,s=new I,o=new I,a=new I,l=new I,c=new I,u=new I,h=new I;if(e)for(let d=0,g=e.count;d<g;d+=3){let M=e.getX(d+0),S=e.getX(d+1),_=e.getX(d+2);r.fromBufferAttribute(t,M),s.fromBufferAttribute(t,S),o.fromBufferAttribute(t,_),u.subVectors(o,s),h.subVectors(r,s),u.cross(h),a.fromBufferAttribute(n,M),l.fromBufferAttribute(n,S),c.fromBufferAttribute(n,_),a.add(u),l.add(u),c.add(u),n.setXYZ(M,a.x,a.y,a.z),n.setXYZ(S,l.x,l.y,l.z),n.setXYZ(_,c.x,c.y,c.z)}else for(let d=0,g=t.count;d<g;d+=3)r.fromBufferAttribute(t,d+0),s.fromBufferAttribute(t,d+1),o.fromBufferAttribute(t,d+2),u.subVectors(o,s),h.subVectors(r,s),u.cross(h),n.setXYZ(d+0,u.x,u.y,u.z),n.setXYZ(d+1,u.x,u.y,u.z),n.setXYZ(d+2,u.x,u.y,u.z);this.normalizeNormals(),n.needsUpdate=!0}}normalizeNormals(){let e=this.attributes.normal;for(let t=0,n=e.count;t<n;t++)ri.fromBufferAttribute(e,t),ri.normalize(),e.setXYZ(t,ri.x,ri.y,ri.z)}toNonIndexed(){function e(a,l){let c=a.array,u=a.itemSize,h=a.normalized,d=new c.constructor(l.length*u),g=0,M=0;for(let S=0,_=l.length;S<_;S++){a.isInterleavedBufferAttribute?g=l[S]*a.data.stride+a.offset:g=l[S]*u;for(let m=0;m<u;m++)d[M++]=c[g++]}return new ni(d,u,h)}if(this.index===null)return Ce("BufferGeometry.toNonIndexed(): BufferGeometry is already non-indexed."),this;let t=new i,n=this.index.array,r=this.attributes;for(let a in r){let l=r[a],c=e(l,n);t.setAttribute(a,c)}let s=this.morphAttributes;for(let a in s){let l=[],c=s[a];for(let u=0,h=c.length;u<h;u++){let d=c[u],g=e(d,n);l.push(g)}t.morphAttributes[a]=l}t.morphTargetsRelative=this.morphTargetsRelative;let o=this.groups;for(let a=0,l=o.length;a<l;a++){let c=o[a];t.addGroup(c.start,c.count,c.materialIndex)}return t}toJSON(){let e={metadata:{version:4.7,type:"BufferGeometry",generator:"BufferGeometry.toJSON"}};if(e.uuid=this.uuid,e.type=this.parameters!==void 0&&this._transformed===!0?"BufferGeometry":this.type,e.name=this.name,Object.keys(this.userData).length>0&&(e.userData=this.userData),this.parameters!==void 0&&this._transformed!==!0){let l=this.parameters;for(let c in l)l[c]!==void 0&&(e[c]=l[c]);return e}e.data={attributes:{}};let t=this.index;t!==null&&(e.data.index={type:t.array.constructor.name,array:Array.prototype.slice.call(t.array)});let n=this.attributes;for(let l in n){let c=n[l];e.data.attributes[l]=c.toJSON(e.data)}let r={},s=!1;for(let l in this.morphAttributes){let c=this.morphAttributes[l],u=[];for(let h=0,d=c.length;h<d;h++){let g=c[h];u.push(g.toJSON(e.data))}u.length>0&&(r[l]=u,s=!0)}s&&(e.data.morphAttributes=r,e.data.morphTargetsRelative=this.morphTargetsRelative);let o=this.groups;o.length>0&&(e.data.groups=JSON.parse(JSON.stringify(o)));let a=this.boundingSphere;return a!==null&&(e.data.boundingSphere=a.toJSON()),e}clone(){return new this.constructor().copy(this)}copy(e){this.index=null,this.attributes={},this.morphAttributes={},this.groups=[],this.boundingBox=null,this.boundingSphere=null;let t={};this.name=e.name;let n=e.index;n!==null&&this.setIndex(n.clone());let r=e.attributes;for(let c in r){let u=r[c];this.setAttribute(c,u.clone(t))}let s=e.morphAttributes;for(let c in s){let u=[],h=s[c];for(let d=0,g=h.length;d<g;d++)u.push(h[d].clone(t));this.morphAttributes[c]=u}this.morphTargetsRelative=e.morphTargetsRelative;let o=e.groups;for(let c=0,u=o.length;c<u;c++){let h=o[c];this.addGroup(h.start,h.count,h.materialIndex)}let a=e.boundingBox;a!==null&&(this.boundingBox=a.clone());let l=e.boundingSphere;return l!==null&&(this.boundingSphere=l.clone()),this.drawRange.start=e.drawRange.start,this.drawRange.count=e.drawRange.count,this.userData=e.userData,this._transformed=e._transformed,this}dispose(){this.dispatchEvent({type:"dispose"})}};var Ic=new I,Cx=new I,Px=new ke,si=class{constructor(e=new I(1,0,0),t=0){this.isPlane=!0,this.normal=e,this.constant=t}set(e,t){return this.normal.copy(e),this.constant=t,this}setComponents(e,t,n,r){return this.normal.set(e,t,n),this.constant=r,this}setFromNormalAndCoplanarPoint(e,t){return this.normal.copy(e),this.constant=-t.dot(this.normal),this}setFromCoplanarPoints(e,t,n){let r=Ic.subVectors(n,t).cross(Cx.subVectors(e,t)).normalize();return this.setFromNormalAndCoplanarPoint(r,e),this}copy(e){return this.normal.copy(e.normal),this.constant=e.constant,this}normalize(){let e=1/this.normal.length();return this.normal.multiplyScalar(e),this.constant*=e,this}negate(){return this.constant*=-1,this.normal.negate(),this}distanceToPoint(e){return this.normal.dot(e)+this.constant}distanceToSphere(e){return this.distanceToPoint(e.center)-e.radius}projectPoint(e,t){return t.copy(e).addScaledVector(this.normal,-this.distanceToPoint(e))}intersectLine(e,t,n=!0){let r=e.delta(Ic),s=this.normal.dot(r);if(s===0)return this.distanceToPoint(e.start)===0?t.copy(e.start):null;let o=-(e.start.dot(this.normal)+this.constant)/s;return n===!0&&(o<0||o>1)?null:t.copy(e.start).addScaledVector(r,o)}intersectsLine(e){let t=this.distanceToPoint(e.start),n=this.distanceToPoint(e.end);return t<0&&n>0||n<0&&t>0}intersectsBox(e){return e.intersectsPlane(this)}intersectsSphere(e){return e.intersectsPlane(this)}coplanarPoint(e){return e.copy(this.normal).multiplyScalar(-this.constant)}applyMatrix4(e,t){let n=t||Px.getNormalMatrix(e),r=this.coplanarPoint(Ic).applyMatrix4(e),s=this.normal.applyMatrix3(n).normalize();return this.constant=-r.dot(s),this}translate(e){return this.constant-=e.dot(this.normal),this}equals(e){return e.normal.equals(this.normal)&&e.constant===this.constant}clone(){return new this.constructor().copy(this)}toJSON(){return{normal:this.normal.toArray(),constant:this.constant}}fromJSON(e){return this.normal.fromArray(e.normal),this.constant=e.constant,this}};var Fx=0,Ii=class extends ii{constructor(){super(),this.isMaterial=!0,Object.defineProperty(this,"id",{value:Fx++}),this.uuid=cn(),this.name="",this.type="Material",this.blending=Yn,this.side=Ji,this.vertexColors=!1,this.opacity=1,this.transparent=!1,this.alphaHash=!1,this.blendSrc=na,this.blendDst=ra,this.blendEquation=$n,this.blendSrcAlpha=null,this.blendDstAlpha=null,this.blendEquationAlpha=null,this.blendColor=new $e(0,0,0),this.blendAlpha=0,this.depthFunc=Kn,this.depthTest=!0,this.depthWrite=!0,this.stencilWriteMask=255,this.stencilFunc=af,this.stencilRef=0,this.stencilFuncMask=255,this.stencilFail=Ea,this.stencilZFail=Ea,this.stencilZPass=Ea,this.stencilWrite=!1,this.clippingPlanes=null,this.clipIntersection=!1,this.clipShadows=!1,this.shadowSide=null,this.colorWrite=!0,this.precision=null,this.polygonOffset=!1,this.polygonOffsetFactor=0,this.polygonOffsetUnits=0,this.dithering=!1,this.alphaToCoverage=!1,this.premultipliedAlpha=!1,this.forceSinglePass=!1,this.allowOverride=!0,this.visible=!0,this.toneMapped=!0,this.userData={},this.version=0,this._alphaTest=0}get alphaTest(){return this._alphaTest}set alphaTest(e){this._alphaTest>0!=e>0&&this.version++,this._alphaTest=e}onBeforeRender(){}onBeforeCompile(){}customProgramCacheKey(){return this.onBeforeCompile.toString()}setValues(e){if(e!==void 0)for(let t in e){let n=e[t];if(n===void 0){Ce(`Material: parameter '${t}' has value of undefined.`);continue}let r=this[t];if(r===void 0){Ce(`Material: '${t}' is not a property of THREE.${this.type}.`);continue}r&&r.isColor?r.set(n):r&&r.isVector2&&n&&n.isVector2||r&&r.isEuler&&n&&n.isEuler||r&&r.isVector3&&n&&n.isVector3?r.copy(n):this[t]=n}}toJSON(e){let t=e===void 0||typeof e=="string";t&&(e={textures:{},images:{}});let n={metadata:{version:4.7,type:"Material",generator:"Material.toJSON"}};n.uuid=this.uuid,n.type=this.type,n.blending=this.blending,n.side=this.side,n.shadowSide=this.shadowSide,n.vertexColors=this.vertexColors,n.opacity=this.opacity,n.transparent=this.transparent,n.blendSrc=this.blendSrc,n.blendDst=this.blendDst,n.blendEquation=this.blendEquation,n.blendSrcAlpha=this.blendSrcAlpha,n.blendDstAlpha=this.blendDstAlpha,n.blendEquationAlpha=this.blendEquationAlpha,n.blendColor=this.blendColor.getHex(),n.blendAlpha=this.blendAlpha,n.depthFunc=this.depthFunc,n.depthTest=this.depthTest,n.depthWrite=this.depthWrite,n.colorWrite=this.colorWrite,n.clipIntersection=this.clipIntersection,n.clipShadows=this.clipShadows,n.stencilWriteMask=this.stencilWriteMask,n.stencilFunc=this.stencilFunc,n.stencilRef=this.stencilRef,n.stencilFuncMask=this.stencilFuncMask,n.stencilFail=this.stencilFail,n.stencilZFail=this.stencilZFail,n.stencilZPass=this.stencilZPass,n.stencilWrite=this.stencilWrite,n.polygonOffset=this.polygonOffset,n.polygonOffsetFactor=this.polygonOffsetFactor,n.polygonOffsetUnits=this.polygonOffsetUnits,n.dithering=this.dithering,n.alphaTest=this.alphaTest,n.alphaHash=this.alphaHash,n.alphaToCoverage=this.alphaToCoverage,n.premultipliedAlpha=this.premultipliedAlpha,n.forceSinglePass=this.forceSinglePass,n.allowOverride=this.allowOverride,n.visible=this.visible,n.toneMapped=this.toneMapped,n.name=this.name,this.color&&this.color.isColor&&(n.color=this.color.getHex()),this.roughness!==void 0&&(n.roughness=this.roughness),this.metalness!==void 0&&(n.metalness=this.metalness),this.sheen!==void 0&&(n.sheen=this.sheen),this.sheenColor&&this.sheenColor.isColor&&(n.sheenColor=this.sheenColor.getHex()),this.sheenRoughness!==void 0&&(n.sheenRoughness=this.sheenRoughness),this.emissive&&this.emissive.isColor&&(n.emissive=this.emissive.getHex()),this.emissiveIntensity!==void 0&&(n.emissiveIntensity=this.emissiveIntensity),this.specular&&this.specular.isColor&&(n.specular=this.specular.getHex()),this.specularIntensity!==void 0&&(n.specularIntensity=this.specularIntensity),this.specularColor&&this.specularColor.isColor&&(n.specularColor=this.specularColor.getHex()),this.shininess!==void 0&&(n.shininess=this.shininess),this.clearcoat!==void 0&&(n.clearcoat=this.clearcoat),this.clearcoatRoughness!==void 0&&(n.clearcoatRoughness=this.clearcoatRoughness),this.diffuseRoughness!==void 0&&(n.diffuseRoughness=this.diffuseRoughness),this.diffuseRoughnessMap&&this.diffuseRoughnessMap.isTexture&&(n.diffuseRoughnessMap=this.diffuseRoughnessMap.toJSON(e).uuid),this.clearcoatMap&&this.clearcoatMap.isTexture&&(n.clearcoatMap=this.clearcoatMap.toJSON(e).uuid),this.clearcoatRoughnessMap&&this.clearcoatRoughnessMap.isTexture&&(n.clearcoatRoughnessMap=this.clearcoatRoughnessMap.toJSON(e).uuid),this.clearcoatNormalMap&&this.clearcoatNormalMap.isTexture&&(n.clearcoatNormalMap=this.clearcoatNormalMap.toJSON(e).uuid,n.clearcoatNormalScale=this.clearcoatNormalScale.toArray()),this.sheenColorMap&&this.sheenColorMap.isTexture&&(n.sheenColorMap=this.sheenColorMap.toJSON(e).uuid),this.sheenRoughnessMap&&this.sheenRoughnessMap.isTexture&&(n.sheenRoughnessMap=this.sheenRoughnessMap.toJSON(e).uuid),this.dispersion!==void 0&&(n.dispersion=this.dispersion),this.retroreflectivity!==void 0&&(n.retroreflectivity=this.retroreflectivity),this.iridescence!==void 0&&(n.iridescence=this.iridescence),this.iridescenceIOR!==void 0&&(n.iridescenceIOR=this.iridescenceIOR),this.iridescenceThicknessMinimum!==void 0&&(n.iridescenceThicknessMinimum=this.iridescenceThicknessMinimum),this.iridescenceThicknessMaximum!==void 0&&(n.iridescenceThicknessMaximum=this.iridescenceThicknessMaximum),this.iridescenceMap&&this.iridescenceMap.isTexture&&(n.iridescenceMap=this.iridescenceMap.toJSON(e).uuid),this.iridescenceThicknessMap&&this.iridescenceThicknessMap.isTexture&&(n.iridescenceThicknessMap=this.iridescenceThicknessMap.toJSON(e).uuid),this.anisotropy!==void 0&&(n.anisotropy=this.anisotropy),this.anisotropyRotation!==void 0&&(n.anisotropyRotation=this.anisotropyRotation),this.anisotropyMap&&this.anisotropyMap.isTexture&&(n.anisotropyMap=this.anisotropyMap.toJSON(e).uuid),this.map&&this.map.isTexture&&(n.map=this.map.toJSON(e).uuid),this.matcap&&this.matcap.isTexture&&(n.matcap=this.matcap.toJSON(e).uuid),this.alphaMap&&this.alphaMap.isTexture&&(n.alphaMap=this.alphaMap.toJSON(e).uuid),this.lightMap&&this.lightMap.isTexture&&(n.lightMap=this.lightMap.toJSON(e).uuid,n.lightMapIntensity=this.lightMapIntensity),this.aoMap&&this.aoMap.isTexture&&(n.aoMap=this.aoMap.toJSON(e).uuid,n.aoMapIntensity=this.aoMapIntensity),this.bumpMap&&this.bumpMap.isTexture&&(n.bumpMap=this.bumpMap.toJSON(e).uuid,n.bumpScale=this.bumpScale),this.normalMap&&this.normalMap.isTexture&&(n.normalMap=this.normalMap.toJSON(e).uuid,n.normalMapType=this.normalMapType,n.normalScale=this.normalScale.toArray()),this.displacementMap&&this.displacementMap.isTexture&&(n.displacementMap=this.displacementMap.toJSON(e).uuid,n.displacementScale=this.displacementScale,n.displacementBias=this.displacementBias),this.roughnessMap&&this.roughnessMap.isTexture&&(n.roughnessMap=this.roughnessMap.toJSON(e).uuid),this.metalnessMap&&this.metalnessMap.isTexture&&(n.metalnessMap=this.metalnessMap.toJSON(e).uuid),this.emissiveMap&&this.emissiveMap.isTexture&&(n.emissiveMap=this.emissiveMap.toJSON(e).uuid),this.specularMap&&this.specularMap.isTexture&&(n.specularMap=this.specularMap.toJSON(e).uuid),this.specularIntensityMap&&this.specularIntensityMap.isTexture&&(n.specularIntensityMap=this.specularIntensityMap.toJSON(e).uuid),this.specularColorMap&&this.specularColorMap.isTexture&&(n.specularColorMap=this.specularColorMap.toJSON(e).uuid),this.envMap&&this.envMap.isTexture&&(n.envMap=this.envMap.toJSON(e).uuid,this.combine!==void 0&&(n.combine=this.combine)),this.envMapRotation!==void 0&&(n.envMapRotation=this.envMapRotation.toArray()),this.envMapIntensity!==void 0&&(n.envMapIntensity=this.envMapIntensity),this.reflectivity!==void 0&&(n.reflectivity=this.reflectivity),this.refractionRatio!==void 0&&(n.refractionRatio=this.refractionRatio),this.gradientMap&&this.gradientMap.isTexture&&(n.gradientMap=this.gradientMap.toJSON(e).uuid),this.transmission!==void 0&&(n.transmission=this.transmission),this.transmissionMap&&this.transmissionMap.isTexture&&(n.transmissionMap=this.transmissionMap.toJSON(e).uuid),this.thickness!==void 0&&(n.thickness=this.thickness),this.thicknessMap&&this.thicknessMap.isTexture&&(n.thicknessMap=this.thicknessMap.toJSON(e).uuid),this.attenuationDistance!==void 0&&(n.attenuationDistance=this.attenuationDistance),this.attenuationColor!==void 0&&(n.attenuationColor=this.attenuationColor.getHex()),this.size!==void 0&&(n.size=this.size),this.sizeAttenuation!==void 0&&(n.sizeAttenuation=this.sizeAttenuation),Array.isArray(this.clippingPlanes)&&this.clippingPlanes.length>0&&(n.clippingPlanes=this.clippingPlanes.map(s=>s.toJSON())),this.rotation!==void 0&&(n.rotation=this.rotation),this.depthPacking!==void 0&&(n.depthPacking=this.depthPacking),this.linewidth!==void 0&&(n.linewidth=this.linewidth),this.linecap!==void 0&&(n.linecap=this.linecap),this.linejoin!==void 0&&(n.linejoin=this.linejoin),this.dashSize!==void 0&&(n.dashSize=this.dashSize),this.gapSize!==void 0&&(n.gapSize=this.gapSize),this.scale!==void 0&&(n.scale=this.scale),this.wireframe!==void 0&&(n.wireframe=this.wireframe),this.wireframeLinewidth!==void 0&&(n.wireframeLinewidth=this.wireframeLinewidth),this.wireframeLinecap!==void 0&&(n.wireframeLinecap=this.wireframeLinecap),this.wireframeLinejoin!==void 0&&(n.wireframeLinejoin=this.wireframeLinejoin),this.flatShading!==void 0&&(n.flatShading=this.flatShading),this.fog!==void 0&&(n.fog=this.fog),Object.keys(this.userData).length>0&&(n.userData=this.userData);function r(s){let o=[];for(let a in s){let l=s[a];delete l.metadata,o.push(l)}return o}if(t){let s=r(e.textures),o=r(e.images);s.length>0&&(n.textures=s),o.length>0&&(n.images=o)}return n}fromJSON(e,t){if(e.uuid!==void 0&&(this.uuid=e.uuid),e.name!==void 0&&(this.name=e.name),e.color!==void 0&&this.color!==void 0&&this.color.setHex(e.color),e.roughness!==void 0&&(this.roughness=e.roughness),e.metalness!==void 0&&(this.metalness=e.metalness),e.sheen!==void 0&&(this.sheen=e.sheen),e.sheenColor!==void 0&&(this.sheenColor=new $e().setHex(e.sheenColor)),e.sheenRoughness!==void 0&&(this.sheenRoughness=e.sheenRoughness),e.emissive!==void 0&&this.emissive!==void 0&&this.emissive.setHex(e.emissive),e.specular!==void 0&&this.specular!==void 0&&this.specular.setHex(e.specular),e.specularIntensity!==void 0&&(this.specularIntensity=e.specularIntensity),e.specularColor!==void 0&&this.specularColor!==void 0&&this.specularColor.setHex(e.specularColor),e.shininess!==void 0&&(this.shininess=e.shininess),e.clearcoat!==void 0&&(this.clearcoat=e.clearcoat),e.clearcoatRoughness!==void 0&&(this.clearcoatRoughness=e.clearcoatRoughness),e.diffuseRoughness!==void 0&&(this.diffuseRoughness=e.diffuseRoughness),e.dispersion!==void 0&&(this.dispersion=e.dispersion),e.retroreflectivity!==void 0&&(this.retroreflectivity=e.retroreflectivity),e.iridescence!==void 0&&(this.iridescence=e.iridescence),e.iridescenceIOR!==void 0&&(this.iridescenceIOR=e.iridescenceIOR),e.iridescenceThicknessMinimum!==void 0&&(this.iridescenceThicknessMinimum=e.iridescenceThicknessMinimum),e.iridescenceThicknessMaximum!==void 0&&(this.iridescenceThicknessMaximum=e.iridescenceThicknessMaximum),e.iridescenceThicknessRange!==void 0&&(this.iridescenceThicknessMinimum=e.iridescenceThicknessRange[0],this.iridescenceThicknessMaximum=e.iridescenceThicknessRange[1]),e.transmission!==void 0&&(this.transmission=e.transmission),e.thickness!==void 0&&(this.thickness=e.thickness),e.attenuationDistance!==void 0&&(this.attenuationDistance=e.attenuationDistance),e.attenuationColor!==void 0&&this.attenuationColor!==void 0&&this.attenuationColor.setHex(e.attenuationColor),e.anisotropy!==void 0&&(this.anisotropy=e.anisotropy),e.anisotropyRotation!==void 0&&(this.anisotropyRotation=e.anisotropyRotation),e.fog!==void 0&&(this.fog=e.fog),e.flatShading!==void 0&&(this.flatShading=e.flatShading),e.blending!==void 0&&(this.blending=e.blending),e.combine!==void 0&&(this.combine=e.combine),e.side!==void 0&&(this.side=e.side),e.shadowSide!==void 0&&(this.shadowSide=e.shadowSide),e.opacity!==void 0&&(this.opacity=e.opacity),e.transparent!==void 0&&(this.transparent=e.transparent),e.alphaTest!==void 0&&(this.alphaTest=e.alphaTest),e.alphaHash!==void 0&&(this.alphaHash=e.alphaHash),e.depthFunc!==void 0&&(this.depthFunc=e.depthFunc),e.depthTest!==void 0&&(this.depthTest=e.depthTest),e.depthWrite!==void 0&&(this.depthWrite=e.depthWrite),e.colorWrite!==void 0&&(this.colorWrite=e.colorWrite),e.clippingPlanes!==void 0&&(this.clippingPlanes=e.clippingPlanes.map(n=>new si().fromJSON(n))),e.clipIntersection!==void 0&&(this.clipIntersection=e.clipIntersection),e.clipShadows!==void 0&&(this.clipShadows=e.clipShadows),e.depthPacking!==void 0&&(this.depthPacking=e.depthPacking),e.blendSrc!==void 0&&(this.blendSrc=e.blendSrc),e.blendDst!==void 0&&(this.blendDst=e.blendDst),e.blendEquation!==void 0&&(this.blendEquation=e.blendEquation),e.blendSrcAlpha!==void 0&&(this.blendSrcAlpha=e.blendSrcAlpha),e.blendDstAlpha!==void 0&&(this.blendDstAlpha=e.blendDstAlpha),e.blendEquationAlpha!==void 0&&(this.blendEquationAlpha=e.blendEquationAlpha),e.blendColor!==void 0&&this.blendColor!==void 0&&this.blendColor.setHex(e.blendColor),e.blendAlpha!==void 0&&(this.blendAlpha=e.blendAlpha),e.stencilWriteMask!==void 0&&(this.stencilWriteMask=e.stencilWriteMask),e.stencilFunc!==void 0&&(this.stencilFunc=e.stencilFunc),e.stencilRef!==void 0&&(this.stencilRef=e.stencilRef),e.stencilFuncMask!==void 0&&(this.stencilFuncMask=e.stencilFuncMask),e.stencilFail!==void 0&&(this.stencilFail=e.stencilFail),e.stencilZFail!==void 0&&(this.stencilZFail=e.stencilZFail),e.stencilZPass!==void 0&&(this.stencilZPass=e.stencilZPass),e.stencilWrite!==void 0&&(this.stencilWrite=e.stencilWrite),e.wireframe!==void 0&&(this.wireframe=e.wireframe),e.wireframeLinewidth!==void 0&&(this.wireframeLinewidth=e.wireframeLinewidth),e.wireframeLinecap!==void 0&&(this.wireframeLinecap=e.wireframeLinecap),e.wireframeLinejoin!==void 0&&(this.wireframeLinejoin=e.wireframeLinejoin),e.rotation!==void 0&&(this.rotation=e.rotation),e.linewidth!==void 0&&(this.linewidth=e.linewidth),e.linecap!==void 0&&(this.linecap=e.linecap),e.linejoin!==void 0&&(this.linejoin=e.linejoin),e.dashSize!==void 0&&(this.dashSize=e.dashSize),e.gapSize!==void 0&&(this.gapSize=e.gapSize),e.scale!==void 0&&(this.scale=e.scale),e.polygonOffset!==void 0&&(this.polygonOffset=e.polygonOffset),e.polygonOffsetFactor!==void 0&&(this.polygonOffsetFactor=e.polygonOffsetFactor),e.polygonOffsetUnits!==void 0&&(this.polygonOffsetUnits=e.polygonOffsetUnits),e.dithering!==void 0&&(this.dithering=e.dithering),e.alphaToCoverage!==void 0&&(this.alphaToCoverage=e.alphaToCoverage),e.premultipliedAlpha!==void 0&&(this.premultipliedAlpha=e.premultipliedAlpha),e.forceSinglePass!==void 0&&(this.forceSinglePass=e.forceSinglePass),e.allowOverride!==void 0&&(this.allowOverride=e.allowOverride),e.visible!==void 0&&(this.visible=e.visible),e.toneMapped!==void 0&&(this.toneMapped=e.toneMapped),e.userData!==void 0&&(this.userData=e.userData),e.vertexColors!==void 0&&(typeof e.vertexColors=="number"?this.vertexColors=e.vertexColors>0:this.vertexColors=e.vertexColors),e.size!==void 0&&(this.size=e.size),e.sizeAttenuation!==void 0&&(this.sizeAttenuation=e.sizeAttenuation),e.map!==void 0&&(this.map=t[e.map]||null),e.matcap!==void 0&&(this.matcap=t[e.matcap]||null),e.alphaMap!==void 0&&(this.alphaMap=t[e.alphaMap]||null),e.bumpMap!==void 0&&(this.bumpMap=t[e.bumpMap]||null),e.bumpScale!==void 0&&(this.bumpScale=e.bumpScale),e.normalMap!==void 0&&(this.normalMap=t[e.normalMap]||null),e.normalMapType!==void 0&&(this.normalMapType=e.normalMapType),e.normalScale!==void 0){let n=e.normalScale;Array.isArray(n)===!1&&(n=[n,n]),this.normalScale=new Oe().fromArray(n)}return e.displacementMap!==void 0&&(this.displacementMap=t[e.displacementMap]||null),e.displacementScale!==void 0&&(this.displacementScale=e.displacementScale),e.displacementBias!==void 0&&(this.displacementBias=e.displacementBias),e.roughnessMap!==void 0&&(this.roughnessMap=t[e.roughnessMap]||null),e.metalnessMap!==void 0&&(this.metalnessMap=t[e.metalnessMap]||null),e.emissiveMap!==void 0&&(this.emissiveMap=t[e.emissiveMap]||null),e.emissiveIntensity!==void 0&&(this.emissiveIntensity=e.emissiveIntensity),e.specularMap!==void 0&&(this.specularMap=t[e.specularMap]||null),e.specularIntensityMap!==void 0&&(this.specularIntensityMap=t[e.specularIntensityMap]||null),e.specularColorMap!==void 0&&(this.specularColorMap=t[e.specularColorMap]||null),e.envMap!==void 0&&(this.envMap=t[e.envMap]||null),e.envMapRotation!==void 0&&this.envMapRotation.fromArray(e.envMapRotation),e.envMapIntensity!==void 0&&(this.envMapIntensity=e.envMapIntensity),e.reflectivity!==void 0&&(this.reflectivity=e.reflectivity),e.refractionRatio!==void 0&&(this.refractionRatio=e.refractionRatio),e.lightMap!==void 0&&(this.lightMap=t[e.lightMap]||null),e.lightMapIntensity!==void 0&&(this.lightMapIntensity=e.lightMapIntensity),e.aoMap!==void 0&&(this.aoMap=t[e.aoMap]||null),e.aoMapIntensity!==void 0&&(this.aoMapIntensity=e.aoMapIntensity),e.gradientMap!==void 0&&(this.gradientMap=t[e.gradientMap]||null),e.clearcoatMap!==void 0&&(this.clearcoatMap=t[e.clearcoatMap]||null),e.clearcoatRoughnessMap!==void 0&&(this.clearcoatRoughnessMap=t[e.clearcoatRoughnessMap]||null),e.clearcoatNormalMap!==void 0&&(this.clearcoatNormalMap=t[e.clearcoatNormalMap]||null),e.clearcoatNormalScale!==void 0&&(this.clearcoatNormalScale=new Oe().fromArray(e.clearcoatNormalScale)),e.diffuseRoughnessMap!==void 0&&(this.diffuseRoughnessMap=t[e.diffuseRoughnessMap]||null),e.iridescenceMap!==void 0&&(this.iridescenceMap=t[e.iridescenceMap]||null),e.iridescenceThicknessMap!==void 0&&(this.iridescenceThicknessMap=t[e.iridescenceThicknessMap]||null),e.transmissionMap!==void 0&&(this.transmissionMap=t[e.transmissionMap]||null),e.thicknessMap!==void 0&&(this.thicknessMap=t[e.thicknessMap]||null),e.anisotropyMap!==void 0&&(this.anisotropyMap=t[e.anisotropyMap]||null),e.sheenColorMap!==void 0&&(this.sheenColorMap=t[e.sheenColorMap]||null),e.sheenRoughnessMap!==void 0&&(this.sheenRoughnessMap=t[e.sheenRoughnessMap]||null),this}clone(){return new this.constructor().copy(this)}copy(e){this.name=e.name,this.blending=e.blending,this.side=e.side,this.vertexColors=e.vertexColors,this.opacity=e.opacity,this.transparent=e.transparent,this.blendSrc=e.blendSrc,this.blendDst=e.blendDst,this.blendEquation=e.blendEquation,this.blendSrcAlpha=e.blendSrcAlpha,this.blendDstAlpha=e.blendDstAlpha,this.blendEquationAlpha=e.blendEquationAlpha,this.blendColor.copy(e.blendColor),this.blendAlpha=e.blendAlpha,this.depthFunc=e.depthFunc,this.depthTest=e.depthTest,this.depthWrite=e.depthWrite,this.stencilWriteMask=e.stencilWriteMask,this.stencilFunc=e.stencilFunc,this.stencilRef=e.stencilRef,this.stencilFuncMask=e.stencilFuncMask,this.stencilFail=e.stencilFail,this.stencilZFail=e.stencilZFail,this.stencilZPass=e.stencilZPass,this.stencilWrite=e.stencilWrite;let t=e.clippingPlanes,n=null;if(t!==null){let r=t.length;n=new Array(r);for(let s=0;s!==r;++s)n[s]=t[s].clone()}return this.clippingPlanes=n,this.clipIntersection=e.clipIntersection,this.clipShadows=e.clipShadows,this.shadowSide=e.shadowSide,this.colorWrite=e.colorWrite,this.precision=e.precision,this.polygonOffset=e.polygonOffset,this.polygonOffsetFactor=e.polygonOffsetFactor,this.polygonOffsetUnits=e.polygonOffsetUnits,this.dithering=e.dithering,this.alphaTest=e.alphaTest,this.alphaHash=e.alphaHash,this.alphaToCoverage=e.alphaToCoverage,this.premultipliedAlpha=e.premultipliedAlpha,this.forceSinglePass=e.forceSinglePass,this.allowOverride=e.allowOverride,this.visible=e.visible,this.toneMapped=e.toneMapped,this.userData=JSON.parse(JSON.stringify(e.userData)),this}dispose(){this.dispatchEvent({type:"dispose"})}set needsUpdate(e){e===!0&&this.version++}};var kn=new I,Oc=new I,za=new I,ka=new I,Yi=class{constructor(e=new I,t=new I(0,0,-1)){this.origin=e,this.direction=t}set(e,t){return this.origin.copy(e),this.direction.copy(t),this}copy(e){return this.origin.copy(e.origin),this.direction.copy(e.direction),this}at(e,t){return t.copy(this.origin).addScaledVector(this.direction,e)}lookAt(e){return this.direction.copy(e).sub(this.origin).normalize(),this}recast(e){return this.origin.copy(this.at(e,kn)),this}closestPointToPoint(e,t){t.subVectors(e,this.origin);let n=t.dot(this.direction);return n<0?t.copy(this.origin):t.copy(this.origin).addScaledVector(this.direction,n)}distanceToPoint(e){return Math.sqrt(this.distanceSqToPoint(e))}distanceSqToPoint(e){let t=kn.subVectors(e,this.origin).dot(this.direction);return t<0?this.origin.distanceToSquared(e):(kn.copy(this.origin).addScaledVector(this.direction,t),kn.distanceToSquared(e))}distanceSqToSegment(e,t,n,r){Oc.copy(e).add(t).multiplyScalar(.5),za.copy(t).sub(e).normalize(),ka.copy(this.origin).sub(Oc);let s=e.distanceTo(t)*.5,o=-this.direction.dot(za),a=ka.dot(this.direction),l=-ka.dot(za),c=ka.lengthSq(),u=Math.abs(1-o*o),h,d,g,M;if(u>0)if(h=o*l-a,d=o*a-l,M=s*u,h>=0)if(d>=-M)if(d<=M){let S=1/u;h*=S,d*=S,g=h*(h+o*d+2*a)+d*(o*h+d+2*l)+c}else d=s,h=Math.max(0,-(o*d+a)),g=-h*h+d*(d+2*l)+c;else d=-s,h=Math.max(0,-(o*d+a)),g=-h*h+d*(d+2*l)+c;else d<=-M?(h=Math.max(0,-(-o*s+a)),d=h>0?-s:Math.min(Math.max(-s,-l),s),g=-h*h+d*(d+2*l)+c):d<=M?(h=0,d=Math.min(Math.max(-s,-l),s),g=d*(d+2*l)+c):(h=Math.max(0,-(o*s+a)),d=h>0?s:Math.min(Math.max(-s,-l),s),g=-h*h+d*(d+2*l)+c);else d=o>0?-s:s,h=Math.max(0,-(o*d+a)),g=-h*h+d*(d+2*l)+c;return n&&n.copy(this.origin).addScaledVector(this.direction,h),r&&r.copy(Oc).addScaledVector(za,d),g}intersectSphere(e,t){if(e.radius<0)return null;kn.subVectors(e.center,this.origin);let n=kn.dot(this.direction),r=kn.dot(kn)-n*n,s=e.radius*e.radius;if(r>s)return null;let o=Math.sqrt(s-r),a=n-o,l=n+o;return l<0?null:a<0?this.at(l,t):this.at(a,t)}intersectsSphere(e){return e.radius<0?!1:this.distanceSqToPoint(e.center)<=e.radius*e.radius}distanceToPlane(e){let t=e.normal.dot(this.direction);if(t===0)return e.distanceToPoint(this.origin)===0?0:null;let n=-(this.origin.dot(e.normal)+e.constant)/t;return n>=0?n:null}intersectPlane(e,t){let n=this.distanceToPlane(e);return n===null?null:this.at(n,t)}intersectsPlane(e){let t=e.distanceToPoint(this.origin);return t===0||e.normal.dot(this.direction)*t<0}intersectBox(e,t){let n,r,s,o,a,l,c=1/this.direction.x,u=1/this.direction.y,h=1/this.direction.z,d=this.origin;return c>=0?(n=(e.min.x-d.x)*c,r=(e.max.x-d.x)*c):(n=(e.max.x-d.x)*c,r=(e.min.x-d.x)*c),u>=0?(s=(e.min.y-d.y)*u,o=(e.max.y-d.y)*u):(s=(e.max.y-d.y)*u,o=(e.min.y-d.y)*u),n>o||s>r||((s>n||isNaN(n))&&(n=s),(o<r||isNaN(r))&&(r=o),h>=0?(a=(e.min.z-d.z)*h,l=(e.max.z-d.z)*h):(a=(e.max.z-d.z)*h,l=(e.min.z-d.z)*h),n>l||a>r)||((a>n||n!==n)&&(n=a),(l<r||r!==r)&&(r=l),r<0)?null:this.at(n>=0?n:r,t)}intersectsBox(e){return this.intersectBox(e,kn)!==null}intersectTriangle(e,t,n,r,s){let o=this.origin,a=this.direction,l=a.x,c=a.y,u=a.z,h=e.x-o.x,d=e.y-o.y,g=e.z-o.z,M=t.x-o.x,S=t.y-o.y,_=t.z-o.z,m=n.x-o.x,b=n.y-o.y,w=n.z-o.z,R=Math.abs(l),P=Math.abs(c),C=Math.abs(u),x,A,V,N,G,W,ee,U,$,ne,O,ue;if(R>=P&&R>=C?(V=l,W=h,$=M,ue=m,l>=0?(x=c,A=u,N=d,G=g,ee=S,U=_,ne=b,O=w):(x=u,A=c,N=g,G=d,ee=_,U=S,ne=w,O=b)):P>=C?(V=c,W=d,$=S,ue=b,c>=0?(x=u,A=l,N=g,G=h,ee=_,U=M,ne=w,O=m):(x=l,A=u,N=h,G=g,ee=M,U=_,ne=m,O=w)):(V=u,W=g,$=_,ue=w,u>=0?(x=l,A=c,N=h,G=d,ee=M,U=S,ne=m,O=b):(x=c,A=l,N=d,G=h,ee=S,U=M,ne=b,O=m)),V===0)return null;let K=x/V,re=A/V,le=1/V,Ue=N-K*W,Ze=G-re*W,Q=ee-K*$,_e=U-re*$,Ee=ne-K*ue,Ge=O-re*ue,be=Ee*_e-Ge*Q,Fe=Ue*Ge-Ze*Ee,Ye=Q*Ze-_e*Ue;if(r){if(be<0||Fe<0||Ye<0)return null}else if((be<0||Fe<0||Ye<0)&&(be>0||Fe>0||Ye>0))return null;let Ve=be+Fe+Ye;if(Ve===0)return null;let dt=le*(be*W+Fe*$+Ye*ue);return(Ve>0?dt<0:dt>0)?null:this.at(dt/Ve,s)}applyMatrix4(e){return this.origin.applyMatrix4(e),this.direction.transformDirection(e),this}equals(e){return e.origin.equals(this.origin)&&e.direction.equals(this.direction)}clone(){return new this.constructor().copy(this)}};var Rr=class extends Ii{constructor(e){super(),this.isMeshBasicMaterial=!0,this.type="MeshBasicMaterial",this.color=new $e(16777215),this.map=null,this.lightMap=null,this.lightMapIntensity=1,this.aoMap=null,this.aoMapIntensity=1,this.specularMap=null,this.alphaMap=null,this.envMap=null,this.envMapRotation=new Sn,this.combine=sa,this.reflectivity=1,this.refractionRatio=.98,this.wireframe=!1,this.wireframeLinewidth=1,this.wireframeLinecap="round",this.wireframeLinejoin="round",this.fog=!0,this.setValues(e)}copy(e){return super.copy(e),this.color.copy(e.color),this.map=e.map,this.lightMap=e.lightMap,this.lightMapIntensity=e.lightMapIntensity,this.aoMap=e.aoMap,this.aoMapIntensity=e.aoMapIntensity,this.specularMap=e.specularMap,this.alphaMap=e.alphaMap,this.envMap=e.envMap,this.envMapRotation.copy(e.envMapRotation),this.combine=e.combine,this.reflectivity=e.reflectivity,this.refractionRatio=e.refractionRatio,this.wireframe=e.wireframe,this.wireframeLinewidth=e.wireframeLinewidth,this.wireframeLinecap=e.wireframeLinecap,this.wireframeLinejoin=e.wireframeLinejoin,this.fog=e.fog,this}};var Lf=new tt,wr=new Yi,Ha=new Qi,Uf=new I,Va=new I,Wa=new I,Xa=new I,Nc=new I,qa=new I,If=new I,Ya=new I,oi=class extends Vt{constructor(e=new Et,t=new Rr){super(),this.isMesh=!0,this.type="Mesh",this.geometry=e,this.material=t,this.morphTargetDictionary=void 0,this.morphTargetInfluences=void 0,this.count=1,this.updateMorphTargets()}copy(e,t){return super.copy(e,t),e.morphTargetInfluences!==void 0?this.morphTargetInfluences=e.morphTargetInfluences.slice():this.morphTargetInfluences=void 0,e.morphTargetDictionary!==void 0?this.morphTargetDictionary=Object.assign({},e.morphTargetDictionary):this.morphTargetDictionary=void 0,this.material=Array.isArray(e.material)?e.material.slice():e.material,this.geometry=e.geometry,this}updateMorphTargets(){let t=this.geometry.morphAttributes,n=Object.keys(t);if(n.length>0){let r=t[n[0]];if(r!==void 0){this.morphTargetInfluences=[],this.morphTargetDictionary={};for(let s=0,o=r.length;s<o;s++){let a=r[s].name||String(s);this.morphTargetInfluences.push(0),this.morphTargetDictionary[a]=s}}}}getVertexPosition(e,t){let n=this.geometry,r=n.attributes.position,s=n.morphAttributes.position,o=n.morphTargetsRelative;t.fromBufferAttribute(r,e);let a=this.morphTargetInfluences;if(s&&a){qa.set(0,0,0);for(let l=0,c=s.length;l<c;l++){let u=a[l],h=s[l];u!==0&&(Nc.fromBufferAttribute(h,e),o?qa.addScaledVector(Nc,u):qa.addScaledVector(Nc.sub(t),u))}t.add(qa)}return t}intersectsFrustum(e){return e.intersectsObject(this)}raycast(e,t){let n=this.geometry,r=this.material,s=this.matrixWorld;r!==void 0&&(n.boundingSphere===null&&n.computeBoundingSphere(),Ha.copy(n.boundingSphere),Ha.applyMatrix4(s),wr.copy(e.ray).recast(e.near),!(Ha.containsPoint(wr.origin)===!1&&(wr.intersectSphere(Ha,Uf)===null||wr.origin.distanceToSquared(Uf)>(e.far-e.near)**2))&&(Lf.copy(s).invert(),wr.copy(e.ray).applyMatrix4(Lf),!(n.boundingBox!==null&&wr.intersectsBox(n.boundingBox)===!1)&&this._computeIntersections(e,t,wr)))}_computeIntersections(e,t,n){let r,s=this.geometry,o=this.material,a=s.index,l=s.attributes.position,c=s.attributes.uv,u=s.attributes.uv1,h=s.attributes.normal,d=s.groups,g=s.drawRange;if(a!==null)if(Array.isArray(o))for(let M=0,S=d.length;M<S;M++){let _=d[M],m=o[_.materialIndex],b=Math.max(_.start,g.start),w=Math.min(a.count,Math.min(_.start+_.count,g.start+g.count));for(let R=b,P=w;R<P;R+=3){let C=a.getX(R),x=a.getX(R+1),A=a.getX(R+2);r=$a(this,m,e,n,c,u,h,C,x,A),r&&(r.faceIndex=Math.floor(R/3),r.face.materialIndex=_.materialIndex,t.push(r))}}else{let M=Math.max(0,g.start),S=Math.min(a.count,g.start+g.count);for(let _=M,m=S;_<m;_+=3){let b=a.getX(_),w=a.getX(_+1),R=a.getX(_+2);r=$a(this,o,e,n,c,u,h,b,w,R),r&&(r.faceIndex=Math.floor(_/3),t.push(r))}}else if(l!==void 0)if(Array.isArray(o))for(let M=0,S=d.length;M<S;M++){let _=d[M],m=o[_.materialIndex],b=Math.max(_.start,g.start),w=Math.min(l.count,Math.min(_.start+_.count,g.start+g.count));for(let R=b,P=w;R<P;R+=3){let C=R,x=R+1,A=R+2;r=$a(this,m,e,n,c,u,h,C,x,A),r&&(r.faceIndex=Math.floor(R/3),r.face.materialIndex=_.materialIndex,t.push(r))}}else{let M=Math.max(0,g.start),S=Math.min(l.count,g.start+g.count);for(let _=M,m=S;_<m;_+=3){let b=_,w=_+1,R=_+2;r=$a(this,o,e,n,c,u,h,b,w,R),r&&(r.faceIndex=Math.floor(_/3),t.push(r))}}}};function Dx(i,e,t,n,r,s,o,a){let l;if(e.side===Ot?l=n.intersectTriangle(o,s,r,!0,a):l=n.intersectTriangle(r,s,o,e.side===Ji,a),l===null)return null;Ya.copy(a),Ya.applyMatrix4(i.matrixWorld);let c=t.ray.origin.distanceTo(Ya);return c<t.near||c>t.far?null:{distance:c,point:Ya.clone(),object:i}}function $a(i,e,t,n,r,s,o,a,l,c){i.getVertexPosition(a,Va),i.getVertexPosition(l,Wa),i.getVertexPosition(c,Xa);let u=Dx(i,e,t,n,Va,Wa,Xa,If);if(u){let h=new I;ir.getBarycoord(If,Va,Wa,Xa,h),r&&(u.uv=ir.getInterpolatedAttribute(r,a,l,c,h,new Oe)),s&&(u.uv1=ir.getInterpolatedAttribute(s,a,l,c,h,new Oe)),o&&(u.normal=ir.getInterpolatedAttribute(o,a,l,c,h,new I),u.normal.dot(n.direction)>0&&u.normal.multiplyScalar(-1));let d={a,b:l,c,normal:new I,materialIndex:0};ir.getNormal(Va,Wa,Xa,d.normal),u.face=d,u.barycoord=h}return u}var Cr=class extends Nt{constructor(e=null,t=1,n=1,r,s,o,a,l,c=Lt,u=Lt,h,d){super(null,o,a,l,c,u,r,s,h,d),this.isDataTexture=!0,this.image={data:e,width:t,height:n},this.generateMipmaps=!1,this.flipY=!1,this.unpackAlignment=1}};var Pr=new Qi,Lx=new Oe(.5,.5),Ka=new I,tn=class{constructor(e=new si,t=new si,n=new si,r=new si,s=new si,o=new si){this.planes=[e,t,n,r,s,o]}set(e,t,n,r,s,o){let a=this.planes;return a[0].copy(e),a[1].copy(t),a[2].copy(n),a[3].copy(r),a[4].copy(s),a[5].copy(o),this}copy(e){let t=this.planes;for(let n=0;n<6;n++)t[n].copy(e.planes[n]);return this}setFromProjectionMatrix(e,t=hi,n=!1){let r=this.planes,s=e.elements,o=s[0],a=s[1],l=s[2],c=s[3],u=s[4],h=s[5],d=s[6],g=s[7],M=s[8],S=s[9],_=s[10],m=s[11],b=s[12],w=s[13],R=s[14],P=s[15];if(r[0].setComponents(c-o,g-u,m-M,P-b).normalize(),r[1].setComponents(c+o,g+u,m+M,P+b).normalize(),r[2].setComponents(c+a,g+h,m+S,P+w).normalize(),r[3].setComponents(c-a,g-h,m-S,P-w).normalize(),n)r[4].setComponents(l,d,_,R).normalize(),r[5].setComponents(c-l,g-d,m-_,P-R).normalize();else if(r[4].setComponents(c-l,g-d,m-_,P-R).normalize(),t===hi)r[5].setComponents(c+l,g+d,m+_,P+R).normalize();else if(t===vr)r[5].setComponents(l,d,_,R).normalize();else throw new Error("THREE.Frustum.setFromProjectionMatrix(): Invalid coordinate system: "+t);return this}intersectsObject(e){if(e.boundingSphere!==void 0)e.boundingSphere===null&&e.computeBoundingSphere(),Pr.copy(e.boundingSphere).applyMatrix4(e.matrixWorld);else{let t=e.geometry;t.boundingSphere===null&&t.computeBoundingSphere(),Pr.copy(t.boundingSphere).applyMatrix4(e.matrixWorld)}return this.intersectsSphere(Pr)}intersectsSprite(e){Pr.center.set(0,0,0);let t=Lx.distanceTo(e.center);return Pr.radius=.7071067811865476+t,Pr.applyMatrix4(e.matrixWorld),this.intersectsSphere(Pr)}intersectsSphere(e){let t=this.planes,n=e.center,r=-e.radius;for(let s=0;s<6;s++)if(t[s].distanceToPoint(n)<r)return!1;return!0}intersectsBox(e){let t=this.planes;for(let n=0;n<6;n++){let r=t[n];if(Ka.x=r.normal.x>0?e.max.x:e.min.x,Ka.y=r.normal.y>0?e.max.y:e.min.y,Ka.z=r.normal.z>0?e.max.z:e.min.z,r.distanceToPoint(Ka)<0)return!1}return!0}containsPoint(e){let t=this.planes;for(let n=0;n<6;n++)if(t[n].distanceToPoint(e)<0)return!1;return!0}clone(){return new this.constructor().copy(this)}};var Of=new tt,Za=class i{constructor(){this.coordinateSystem=hi,this._frustums=[],this._count=0}setFromArrayCamera(e){let t=e.cameras,n=this._frustums;for(let r=0;r<t.length;r++){let s=t[r];Of.multiplyMatrices(s.projectionMatrix,s.matrixWorldInverse),n[r]===void 0&&(n[r]=new tn),n[r].setFromProjectionMatrix(Of,s.coordinateSystem,s.reversedDepth)}return this._count=t.length,this}getFrustum(e){return this._frustums[e]}intersectsObject(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsObject(e))return!0;return!1}intersectsSprite(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsSprite(e))return!0;return!1}intersectsSphere(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsSphere(e))return!0;return!1}intersectsBox(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsBox(e))return!0;return!1}containsPoint(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].containsPoint(e))return!0;return!1}copy(e){this.coordinateSystem=e.coordinateSystem;let t=this._frustums,n=e._frustums;for(let r=0;r<e._count;r++)t[r]===void 0&&(t[r]=new tn),t[r].copy(n[r]);return this._count=e._count,this}clone(){return new i().copy(this)}};var $i=class extends Ii{constructor(e){super(),this.isLineBasicMaterial=!0,this.type="LineBasicMaterial",this.color=new $e(16777215),this.map=null,this.linewidth=1,this.linecap="round",this.linejoin="round",this.fog=!0,this.setValues(e)}copy(e){return super.copy(e),this.color.copy(e.color),this.map=e.map,this.linewidth=e.linewidth,this.linecap=e.linecap,this.linejoin=e.linejoin,this.fog=e.fog,this}};var Qa=new I,el=new I,Nf=new tt,Co=new Yi,Ja=new Qi,Bc=new I,Bf=new I,Fr=class extends Vt{constructor(e=new Et,t=new $i){super(),this.isLine=!0,this.type="Line",this.geometry=e,this.material=t,this.morphTargetDictionary=void 0,this.morphTargetInfluences=void 0,this.updateMorphTargets()}copy(e,t){return super.copy(e,t),e.morphTargetInfluences!==void 0?this.morphTargetInfluences=e.morphTargetInfluences.slice():this.morphTargetInfluences=void 0,e.morphTargetDictionary!==void 0?this.morphTargetDictionary=Object.assign({},e.morphTargetDictionary):this.morphTargetDictionary=void 0,this.material=Array.isArray(e.material)?e.material.slice():e.material,this.geometry=e.geometry,this}computeLineDistances(){let e=this.geometry;if(e.index===null){let t=e.attributes.position,n=[0];for(let r=1,s=t.count;r<s;r++)Qa.fromBufferAttribute(t,r-1),el.fromBufferAttribute(t,r),n[r]=n[r-1],n[r]+=Qa.distanceTo(el);e.setAttribute("lineDistance",new Ft(n,1))}else Ce("Line.computeLineDistances(): Computation only possible with non-indexed BufferGeometry.");return this}intersectsFrustum(e){return e.intersectsObject(this)}raycast(e,t){let n=this.geometry,r=this.matrixWorld,s=e.params.Line.threshold,o=n.drawRange;if(n.boundingSphere===null&&n.computeBoundingSphere(),Ja.copy(n.boundingSphere),Ja.applyMatrix4(r),Ja.radius+=s,e.ray.intersectsSphere(Ja)===!1)return;Nf.copy(r).invert(),Co.copy(e.ray).applyMatrix4(Nf);let a=s/((this.scale.x+this.scale.y+this.scale.z)/3),l=a*a,c=this.isLineSegments?2:1,u=n.index,d=n.attributes.position;if(u!==null){let g=Math.max(0,o.start),M=Math.min(u.count,o.start+o.count);for(let S=g,_=M-1;S<_;S+=c){let m=u.getX(S),b=u.getX(S+1),w=ja(this,e,Co,l,m,b,S);w&&t.push(w)}if(this.isLineLoop){let S=u.getX(M-1),_=u.getX(g),m=ja(this,e,Co,l,S,_,M-1);m&&t.push(m)}}else{let g=Math.max(0,o.start),M=Math.min(d.count,o.start+o.count);for(let S=g,_=M-1;S<_;S+=c){let m=ja(this,e,Co,l,S,S+1,S);m&&t.push(m)}if(this.isLineLoop){let S=ja(this,e,Co,l,M-1,g,M-1);S&&t.push(S)}}}updateMorphTargets(){let t=this.geometry.morphAttributes,n=Object.keys(t);if(n.length>0){let r=t[n[0]];if(r!==void 0){this.morphTargetInfluences=[],this.morphTargetDictionary={};for(let s=0,o=r.length;s<o;s++){let a=r[s].name||String(s);this.morphTargetInfluences.push(0),this.morphTargetDictionary[a]=s}}}}};function ja(i,e,t,n,r,s,o){let a=i.geometry.attributes.position;if(Qa.fromBufferAttribute(a,r),el.fromBufferAttribute(a,s),t.distanceSqToSegment(Qa,el,Bc,Bf)>n)return;Bc.applyMatrix4(i.matrixWorld);let c=e.ray.origin.distanceTo(Bc);if(!(c<e.near||c>e.far))return{distance:c,point:Bf.clone().applyMatrix4(i.matrixWorld),index:o,face:null,faceIndex:null,barycoord:null,object:i}}var Gf=new I,zf=new I,Hn=class extends Fr{constructor(e,t){super(e,t),this.isLineSegments=!0,this.type="LineSegments"}computeLineDistances(){let e=this.geometry;if(e.index===null){let t=e.attributes.position,n=[];for(let r=0,s=t.count;r<s;r+=2)Gf.fromBufferAttribute(t,r),zf.fromBufferAttribute(t,r+1),n[r]=r===0?0:n[r-1],n[r+1]=n[r]+Gf.distanceTo(zf);e.setAttribute("lineDistance",new Ft(n,1))}else Ce("LineSegments.computeLineDistances(): Computation only possible with non-indexed BufferGeometry.");return this}};var Dr=class extends Ii{constructor(e){super(),this.isPointsMaterial=!0,this.type="PointsMaterial",this.color=new $e(16777215),this.map=null,this.alphaMap=null,this.size=1,this.sizeAttenuation=!0,this.fog=!0,this.setValues(e)}copy(e){return super.copy(e),this.color.copy(e.color),this.map=e.map,this.alphaMap=e.alphaMap,this.size=e.size,this.sizeAttenuation=e.sizeAttenuation,this.fog=e.fog,this}};var kf=new tt,Gc=new Yi,tl=new Qi,il=new I,Lr=class extends Vt{constructor(e=new Et,t=new Dr){super(),this.isPoints=!0,this.type="Points",this.geometry=e,this.material=t,this.morphTargetDictionary=void 0,this.morphTargetInfluences=void 0,this.updateMorphTargets()}copy(e,t){return super.copy(e,t),e.morphTargetInfluences!==void 0?this.morphTargetInfluences=e.morphTargetInfluences.slice():this.morphTargetInfluences=void 0,e.morphTargetDictionary!==void 0?this.morphTargetDictionary=Object.assign({},e.morphTargetDictionary):this.morphTargetDictionary=void 0,this.material=Array.isArray(e.material)?e.material.slice():e.material,this.geometry=e.geometry,this}intersectsFrustum(e){return e.intersectsObject(this)}raycast(e,t){let n=this.geometry,r=this.matrixWorld,s=e.params.Points.threshold,o=n.drawRange;if(n.boundingSphere===null&&n.computeBoundingSphere(),tl.copy(n.boundingSphere),tl.applyMatrix4(r),tl.radius+=s,e.ray.intersectsSphere(tl)===!1)return;kf.copy(r).invert(),Gc.copy(e.ray).applyMatrix4(kf);let a=s/((this.scale.x+this.scale.y+this.scale.z)/3),l=a*a,c=n.index,h=n.attributes.position;if(c!==null){let d=Math.max(0,o.start),g=Math.min(c.count,o.start+o.count);for(let M=d,S=g;M<S;M++){let _=c.getX(M);il.fromBufferAttribute(h,_),Hf(il,_,l,r,e,t,this)}}else{let d=Math.max(0,o.start),g=Math.min(h.count,o.start+o.count);for(let M=d,S=g;M<S;M++)il.fromBufferAttribute(h,M),Hf(il,M,l,r,e,t,this)}}updateMorphTargets(){let t=this.geometry.morphAttributes,n=Object.keys(t);if(n.length>0){let r=t[n[0]];if(r!==void 0){this.morphTargetInfluences=[],this.morphTargetDictionary={};for(let s=0,o=r.length;s<o;s++){let a=r[s].name||String(s);this.morphTargetInfluences.push(0),this.morphTargetDictionary[a]=s}}}}};function Hf(i,e,t,n,r,s,o){let a=Gc.distanceSqToPoint(i);if(a<t){let l=new I;Gc.closestPointToPoint(i,l),l.applyMatrix4(n);let c=r.ray.origin.distanceTo(l);if(c<r.near||c>r.far)return;s.push({distance:c,distanceToRay:Math.sqrt(a),point:l,index:e,face:null,faceIndex:null,barycoord:null,object:o})}}var gs=class extends Nt{constructor(e=[],t=vn,n,r,s,o,a,l,c,u){super(e,t,n,r,s,o,a,l,c,u),this.isCubeTexture=!0,this.flipY=!1}get images(){return this.image}set images(e){this.image=e}};var Ki=class extends Nt{constructor(e,t,n=ei,r,s,o,a=Lt,l=Lt,c,u=Ui,h=1){if(u!==Ui&&u!==Hi)throw new Error("THREE.DepthTexture: format must be either THREE.DepthFormat or THREE.DepthStencilFormat");let d={width:e,height:t,depth:h};super(d,r,s,o,a,l,u,n,c),this.isDepthTexture=!0,this.flipY=!1,this.generateMipmaps=!1,this.compareFunction=null}copy(e){return super.copy(e),this.source=new jn(Object.assign({},e.image)),this.compareFunction=e.compareFunction,this}toJSON(e){let t=super.toJSON(e);return t.compareFunction=this.compareFunction,t}};var _s=class extends Ki{constructor(e,t=ei,n=vn,r,s,o=Lt,a=Lt,l,c=Ui){let u={width:e,height:e,depth:1},h=[u,u,u,u,u,u];super(e,e,t,n,r,s,o,a,l,c),this.image=h,this.isCubeDepthTexture=!0,this.isCubeTexture=!0}get images(){return this.image}set images(e){this.image=e}};var xs=class extends Nt{constructor(e=null){super(),this.sourceTexture=e,this.isExternalTexture=!0}copy(e){return super.copy(e),this.sourceTexture=e.sourceTexture,this}};var sr=class i extends Et{constructor(e=1,t=1,n=1,r=1,s=1,o=1){super(),this.type="BoxGeometry",this.parameters={width:e,height:t,depth:n,widthSegments:r,heightSegments:s,depthSegments:o};let a=this;r=Math.floor(r),s=Math.floor(s),o=Math.floor(o);let l=[],c=[],u=[],h=[],d=0,g=0;M("z","y","x",-1,-1,n,t,e,o,s,0),M("z","y","x",1,-1,n,t,-e,o,s,1),M("x","z","y",1,1,e,n,t,r,o,2),M("x","z","y",1,-1,e,n,-t,r,o,3),M("x","y","z",1,-1,e,t,n,r,s,4),M("x","y","z",-1,-1,e,t,-n,r,s,5),this.setIndex(l),this.setAttribute("position",new Ft(c,3)),this.setAttribute("normal",new Ft(u,3)),this.setAttribute("uv",new Ft(h,2));function M(S,_,m,b,w,R,P,C,x,A,V){let N=R/x,G=P/A,W=R/2,ee=P/2,U=C/2,$=x+1,ne=A+1,O=0,ue=0,K=new I;for(let re=0;re<ne;re++){let le=re*G-ee;for(let Ue=0;Ue<$;Ue++){let Ze=Ue*N-W;K[S]=Ze*b,K[_]=le*w,K[m]=U,c.push(K.x,K.y,K.z),K[S]=0,K[_]=0,K[m]=C>0?1:-1,u.push(K.x,K.y,K.z),h.push(Ue/x),h.push(1-re/A),O+=1}}for(let re=0;re<A;re++)for(let le=0;le<x;le++){let Ue=d+le+$*re,Ze=d+le+$*(re+1),Q=d+(le+1)+$*(re+1),_e=d+(le+1)+$*re;l.push(Ue,Ze,_e),l.push(Ze,Q,_e),ue+=6}a.addGroup(g,ue,V),g+=ue,d+=O}}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}static fromJSON(e){return new i(e.width,e.height,e.depth,e.widthSegments,e.heightSegments,e.depthSegments)}};var Ms=class i extends Et{constructor(e=1,t=1,n=1,r=1){super(),this.type="PlaneGeometry",this.parameters={width:e,height:t,widthSegments:n,heightSegments:r};let s=e/2,o=t/2,a=Math.floor(n),l=Math.floor(r),c=a+1,u=l+1,h=e/a,d=t/l,g=[],M=[],S=[],_=[];for(let m=0;m<u;m++){let b=m*d-o;for(let w=0;w<c;w++){let R=w*h-s;M.push(R,-b,0),S.push(0,0,1),_.push(w/a),_.push(1-m/l)}}for(let m=0;m<l;m++)for(let b=0;b<a;b++){let w=b+c*m,R=b+c*(m+1),P=b+1+c*(m+1),C=b+1+c*m;g.push(w,R,C),g.push(R,P,C)}this.setIndex(g),this.setAttribute("position",new Ft(M,3)),this.setAttribute("normal",new Ft(S,3)),this.setAttribute("uv",new Ft(_,2))}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}static fromJSON(e){return new i(e.width,e.height,e.widthSegments,e.heightSegments)}};function Vn(i){let e={};for(let t in i){e[t]={};for(let n in i[t]){let r=i[t][n];if(Vf(r))r.isRenderTargetTexture?(Ce("UniformsUtils: Textures of render targets cannot be cloned via cloneUniforms() or mergeUniforms()."),e[t][n]=null):e[t][n]=r.clone();else if(Array.isArray(r))if(Vf(r[0])){let s=[];for(let o=0,a=r.length;o<a;o++)s[o]=r[o].clone();e[t][n]=s}else e[t][n]=r.slice();else e[t][n]=r}}return e}function Ei(i){let e={};for(let t=0;t<i.length;t++){let n=Vn(i[t]);for(let r in n)e[r]=n[r]}return e}function Vf(i){return i&&(i.isColor||i.isMatrix3||i.isMatrix4||i.isVector2||i.isVector3||i.isVector4||i.isTexture||i.isQuaternion)}function Wf(i){let e=[];for(let t=0;t<i.length;t++)e.push(i[t].clone());return e}function nl(i){let e=i.getRenderTarget();return e===null?i.outputColorSpace:e.isXRRenderTarget===!0?e.texture.colorSpace:je.workingColorSpace}var Xf={clone:Vn,merge:Ei};var qf=`
void main() {
	gl_Position = projectionMatrix * modelViewMatrix * vec4( position, 1.0 );
}
`;var Yf=`
void main() {
	gl_FragColor = vec4( 1.0, 0.0, 0.0, 1.0 );
}
`;var ai=class extends Ii{constructor(e){super(),this.isShaderMaterial=!0,this.type="ShaderMaterial",this.defines={},this.uniforms={},this.uniformsGroups=[],this.vertexShader=qf,this.fragmentShader=Yf,this.linewidth=1,this.wireframe=!1,this.wireframeLinewidth=1,this.fog=!1,this.lights=!1,this.clipping=!1,this.forceSinglePass=!0,this.extensions={clipCullDistance:!1,multiDraw:!1},this.defaultAttributeValues={color:[1,1,1],uv:[0,0],uv1:[0,0]},this.index0AttributeName=void 0,this.uniformsNeedUpdate=!1,this.glslVersion=null,e!==void 0&&this.setValues(e)}copy(e){return super.copy(e),this.fragmentShader=e.fragmentShader,this.vertexShader=e.vertexShader,this.uniforms=Vn(e.uniforms),this.uniformsGroups=Wf(e.uniformsGroups),this.defines=Object.assign({},e.defines),this.wireframe=e.wireframe,this.wireframeLinewidth=e.wireframeLinewidth,this.fog=e.fog,this.lights=e.lights,this.clipping=e.clipping,this.extensions=Object.assign({},e.extensions),this.glslVersion=e.glslVersion,this.defaultAttributeValues=Object.assign({},e.defaultAttributeValues),this.index0AttributeName=e.index0AttributeName,this.uniformsNeedUpdate=e.uniformsNeedUpdate,this}toJSON(e){let t=super.toJSON(e);t.glslVersion=this.glslVersion,t.uniforms={};for(let r in this.uniforms){let o=this.uniforms[r].value;o&&o.isTexture?t.uniforms[r]={type:"t",value:o.toJSON(e).uuid}:o&&o.isColor?t.uniforms[r]={type:"c",value:o.getHex()}:o&&o.isVector2?t.uniforms[r]={type:"v2",value:o.toArray()}:o&&o.isVector3?t.uniforms[r]={type:"v3",value:o.toArray()}:o&&o.isVector4?t.uniforms[r]={type:"v4",value:o.toArray()}:o&&o.isMatrix3?t.uniforms[r]={type:"m3",value:o.toArray()}:o&&o.isMatrix4?t.uniforms[r]={type:"m4",value:o.toArray()}:t.uniforms[r]={value:o}}Object.keys(this.defines).length>0&&(t.defines=this.defines),t.vertexShader=this.vertexShader,t.fragmentShader=this.fragmentShader,t.lights=this.lights,t.clipping=this.clipping;let n={};for(let r in this.extensions)this.extensions[r]===!0&&(n[r]=!0);return Object.keys(n).length>0&&(t.extensions=n),t}fromJSON(e,t){if(super.fromJSON(e,t),e.uniforms!==void 0)for(let n in e.uniforms){let r=e.uniforms[n];switch(this.uniforms[n]={},r.type){case"t":this.uniforms[n].value=t[r.value]||null;break;case"c":this.uniforms[n].value=new $e().setHex(r.value);break;case"v2":this.uniforms[n].value=new Oe().fromArray(r.value);break;case"v3":this.uniforms[n].value=new I().fromArray(r.value);break;case"v4":this.uniforms[n].value=new vt().fromArray(r.value);break;case"m3":this.uniforms[n].value=new ke().fromArray(r.value);break;case"m4":this.uniforms[n].value=new tt().fromArray(r.value);break;default:this.uniforms[n].value=r.value}}if(e.defines!==void 0&&(this.defines=e.defines),e.vertexShader!==void 0&&(this.vertexShader=e.vertexShader),e.fragmentShader!==void 0&&(this.fragmentShader=e.fragmentShader),e.glslVersion!==void 0&&(this.glslVersion=e.glslVersion),e.extensions!==void 0)for(let n in e.extensions)this.extensions[n]=e.extensions[n];return e.lights!==void 0&&(this.lights=e.lights),e.clipping!==void 0&&(this.clipping=e.clipping),this}};var rl=class extends ai{constructor(e){super(e),this.isRawShaderMaterial=!0,this.type="RawShaderMaterial"}};var sl=class extends Ii{constructor(e){super(),this.isMeshDepthMaterial=!0,this.type="MeshDepthMaterial",this.depthPacking=sf,this.map=null,this.alphaMap=null,this.displacementMap=null,this.displacementScale=1,this.displacementBias=0,this.wireframe=!1,this.wireframeLinewidth=1,this.setValues(e)}copy(e){return super.copy(e),this.depthPacking=e.depthPacking,this.map=e.map,this.alphaMap=e.alphaMap,this.displacementMap=e.displacementMap,this.displacementScale=e.displacementScale,this.displacementBias=e.displacementBias,this.wireframe=e.wireframe,this.wireframeLinewidth=e.wireframeLinewidth,this}};var ol=class extends Ii{constructor(e){super(),this.isMeshDistanceMaterial=!0,this.type="MeshDistanceMaterial",this.map=null,this.alphaMap=null,this.displacementMap=null,this.displacementScale=1,this.displacementBias=0,this.setValues(e)}copy(e){return super.copy(e),this.map=e.map,this.alphaMap=e.alphaMap,this.displacementMap=e.displacementMap,this.displacementScale=e.displacementScale,this.displacementBias=e.displacementBias,this}};var al={enabled:!1,files:{},add:function(i,e){this.enabled!==!1&&($f(i)||(this.files[i]=e))},get:function(i){if(this.enabled!==!1&&!$f(i))return this.files[i]},remove:function(i){delete this.files[i]},clear:function(){this.files={}}};function $f(i){try{let e=i.slice(i.indexOf(":")+1);return new URL(e).protocol==="blob:"}catch{return!1}}var zc=class{constructor(e,t,n){let r=this,s=!1,o=0,a=0,l,c=[];this.onStart=void 0,this.onLoad=e,this.onProgress=t,this.onError=n,this._abortController=null,this.itemStart=function(u){a++,s===!1&&r.onStart!==void 0&&r.onStart(u,o,a),s=!0},this.itemEnd=function(u){o++,r.onProgress!==void 0&&r.onProgress(u,o,a),o===a&&(s=!1,r.onLoad!==void 0&&r.onLoad())},this.itemError=function(u){r.onError!==void 0&&r.onError(u)},this.resolveURL=function(u){return u=u.normalize("NFC"),l?l(u):u},this.setURLModifier=function(u){return l=u,this},this.addHandler=function(u,h){return c.push(u,h),this},this.removeHandler=function(u){let h=c.indexOf(u);return h!==-1&&c.splice(h,2),this},this.getHandler=function(u){for(let h=0,d=c.length;h<d;h+=2){let g=c[h],M=c[h+1];if(g.global&&(g.lastIndex=0),g.test(u))return M}return null},this.abort=function(){return this.abortController.abort(),this._abortController=null,this}}get abortController(){return this._abortController||(this._abortController=new AbortController),this._abortController}},Kf=new zc;var Ur=class{constructor(e){this.manager=e!==void 0?e:Kf,this.crossOrigin="anonymous",this.withCredentials=!1,this.path="",this.resourcePath="",this.requestHeader={},this.priority="auto",this.cache="default",typeof __THREE_DEVTOOLS__<"u"&&__THREE_DEVTOOLS__.dispatchEvent(new CustomEvent("observe",{detail:this}))}load(){}loadAsync(e,t){let n=this;return new Promise(function(r,s){n.load(e,r,t,s)})}parse(){}setCrossOrigin(e){return this.crossOrigin=e,this}setWithCredentials(e){return this.withCredentials=e,this}setPath(e){return this.path=e,this}setResourcePath(e){return this.resourcePath=e,this}setRequestHeader(e){return this.requestHeader=e,this}setPriority(e){return this.priority=e,this}setCache(e){return this.cache=e,this}abort(){return this}};Ur.DEFAULT_MATERIAL_NAME="__DEFAULT";var ys=new WeakMap,ll=class extends Ur{constructor(e){super(e)}load(e,t,n,r){this.path!==void 0&&(e=this.path+e),e=this.manager.resolveURL(e);let s=this,o=al.get(`image:${e}`);if(o!==void 0){if(o.complete===!0)s.manager.itemStart(e),setTimeout(function(){t&&t(o),s.manager.itemEnd(e)},0);else{let h=ys.get(o);h===void 0&&(h=[],ys.set(o,h)),h.push({onLoad:t,onError:r})}return o}let a=Jn("img");function l(){u(),t&&t(this);let h=ys.get(this)||[];for(let d=0;d<h.length;d++){let g=h[d];g.onLoad&&g.onLoad(this)}ys.delete(this),s.manager.itemEnd(e)}function c(h){u(),r&&r(h),al.remove(`image:${e}`);let d=ys.get(this)||[];for(let g=0;g<d.length;g++){let M=d[g];M.onError&&M.onError(h)}ys.delete(this),s.manager.itemError(e),s.manager.itemEnd(e)}function u(){a.removeEventListener("load",l,!1),a.removeEventListener("error",c,!1)}return a.addEventListener("load",l,!1),a.addEventListener("error",c,!1),e.slice(0,5)!=="data:"&&this.crossOrigin!==void 0&&(a.crossOrigin=this.crossOrigin),al.add(`image:${e}`,a),s.manager.itemStart(e),a.fetchPriority=this.priority,a.src=e,a}};var Po=class extends Ur{constructor(e){super(e)}load(e,t,n,r){let s=new Nt,o=new ll(this.manager);return o.setPriority(this.priority),o.setCache(this.cache),o.setCrossOrigin(this.crossOrigin),o.setPath(this.path),o.load(e,function(a){s.image=a,s.needsUpdate=!0,t!==void 0&&t(s)},n,r),s}};var cl=new I,ul=new yi,En=new I,vs=class extends Vt{constructor(){super(),this.isCamera=!0,this.type="Camera",this.matrixWorldInverse=new tt,this.projectionMatrix=new tt,this.projectionMatrixInverse=new tt,this.coordinateSystem=hi,this._reversedDepth=!1}get reversedDepth(){return this._reversedDepth}copy(e,t){return super.copy(e,t),this.matrixWorldInverse.copy(e.matrixWorldInverse),this.projectionMatrix.copy(e.projectionMatrix),this.projectionMatrixInverse.copy(e.projectionMatrixInverse),this.coordinateSystem=e.coordinateSystem,this}getWorldDirection(e){return super.getWorldDirection(e).negate()}updateMatrixWorld(e){super.updateMatrixWorld(e),this.matrixWorld.decompose(cl,ul,En),En.x===1&&En.y===1&&En.z===1?this.matrixWorldInverse.copy(this.matrixWorld).invert():this.matrixWorldInverse.compose(cl,ul,En.set(1,1,1)).invert()}updateWorldMatrix(e,t,n=!1){super.updateWorldMatrix(e,t,n),this.matrixWorld.decompose(cl,ul,En),En.x===1&&En.y===1&&En.z===1?this.matrixWorldInverse.copy(this.matrixWorld).invert():this.matrixWorldInverse.compose(cl,ul,En.set(1,1,1)).invert()}clone(){return new this.constructor().copy(this)}};var or=new I,Zf=new Oe,Jf=new Oe,li=class extends vs{constructor(e=50,t=1,n=.1,r=2e3){super(),this.isPerspectiveCamera=!0,this.type="PerspectiveCamera",this.fov=e,this.zoom=1,this.near=n,this.far=r,this.focus=10,this.aspect=t,this.view=null,this.filmGauge=35,this.filmOffset=0,this.updateProjectionMatrix()}copy(e,t){return super.copy(e,t),this.fov=e.fov,this.zoom=e.zoom,this.near=e.near,this.far=e.far,this.focus=e.focus,this.aspect=e.aspect,this.view=e.view===null?null:Object.assign({},e.view),this.filmGauge=e.filmGauge,this.filmOffset=e.filmOffset,this}setFocalLength(e){let t=.5*this.getFilmHeight()/e;this.fov=Er*2*Math.atan(t),this.updateProjectionMatrix()}getFocalLength(){let e=Math.tan(es*.5*this.fov);return .5*this.getFilmHeight()/e}getEffectiveFOV(){return Er*2*Math.atan(Math.tan(es*.5*this.fov)/this.zoom)}getFilmWidth(){return this.filmGauge*Math.min(this.aspect,1)}getFilmHeight(){return this.filmGauge/Math.max(this.aspect,1)}getViewBounds(e,t,n){or.set(-1,-1,.5).applyMatrix4(this.projectionMatrixInverse),t.set(or.x,or.y).multiplyScalar(-e/or.z),or.set(1,1,.5).applyMatrix4(this.projectionMatrixInverse),n.set(or.x,or.y).multiplyScalar(-e/or.z)}getViewSize(e,t){return this.getViewBounds(e,Zf,Jf),t.subVectors(Jf,Zf)}setViewOffset(e,t,n,r,s,o){this.aspect=e/t,this.view===null&&(this.view={enabled:!0,fullWidth:1,fullHeight:1,offsetX:0,offsetY:0,width:1,height:1}),this.view.enabled=!0,this.view.fullWidth=e,this.view.fullHeight=t,this.view.offsetX=n,this.view.offsetY=r,this.view.width=s,this.view.height=o,this.updateProjectionMatrix()}clearViewOffset(){this.view!==null&&(this.view.enabled=!1),this.updateProjectionMatrix()}updateProjectionMatrix(){let e=this.near,t=e*Math.tan(es*.5*this.fov)/this.zoom,n=2*t,r=this.aspect*n,s=-.5*r,o=this.view;if(this.view!==null&&this.view.enabled){let l=o.fullWidth,c=o.fullHeight;s+=o.offsetX*r/l,t-=o.offsetY*n/c,r*=o.width/l,n*=o.height/c}let a=this.filmOffset;a!==0&&(s+=e*a/this.getFilmWidth()),this.projectionMatrix.makePerspective(s,s+r,t,t-n,e,this.far,this.coordinateSystem,this.reversedDepth),this.projectionMatrixInverse.copy(this.projectionMatrix).invert()}toJSON(e){let t=super.toJSON(e);return t.object.fov=this.fov,t.object.zoom=this.zoom,t.object.near=this.near,t.object.far=this.far,t.object.focus=this.focus,t.object.aspect=this.aspect,this.view!==null&&(t.object.view=Object.assign({},this.view)),t.object.filmGauge=this.filmGauge,t.object.filmOffset=this.filmOffset,t}};var fl=class extends vs{constructor(e=-1,t=1,n=1,r=-1,s=.1,o=2e3){super(),this.isOrthographicCamera=!0,this.type="OrthographicCamera",this.zoom=1,this.view=null,this.left=e,this.right=t,this.top=n,this.bottom=r,this.near=s,this.far=o,this.updateProjectionMatrix()}copy(e,t){return super.copy(e,t),this.left=e.left,this.right=e.right,this.top=e.top,this.bottom=e.bottom,this.near=e.near,this.far=e.far,this.zoom=e.zoom,this.view=e.view===null?null:Object.assign({},e.view),this}setViewOffset(e,t,n,r,s,o){this.view===null&&(this.view={enabled:!0,fullWidth:1,fullHeight:1,offsetX:0,offsetY:0,width:1,height:1}),this.view.enabled=!0,this.view.fullWidth=e,this.view.fullHeight=t,this.view.offsetX=n,this.view.offsetY=r,this.view.width=s,this.view.height=o,this.updateProjectionMatrix()}clearViewOffset(){this.view!==null&&(this.view.enabled=!1),this.updateProjectionMatrix()}updateProjectionMatrix(){let e=(this.right-this.left)/(2*this.zoom),t=(this.top-this.bottom)/(2*this.zoom),n=(this.right+this.left)/2,r=(this.top+this.bottom)/2,s=n-e,o=n+e,a=r+t,l=r-t;if(this.view!==null&&this.view.enabled){let c=(this.right-this.left)/this.view.fullWidth/this.zoom,u=(this.top-this.bottom)/this.view.fullHeight/this.zoom;s+=c*this.view.offsetX,o=s+c*this.view.width,a-=u*this.view.offsetY,l=a-u*this.view.height}this.projectionMatrix.makeOrthographic(s,o,a,l,this.near,this.far,this.coordinateSystem,this.reversedDepth),this.projectionMatrixInverse.copy(this.projectionMatrix).invert()}toJSON(e){let t=super.toJSON(e);return t.object.zoom=this.zoom,t.object.left=this.left,t.object.right=this.right,t.object.top=this.top,t.object.bottom=this.bottom,t.object.near=this.near,t.object.far=this.far,this.view!==null&&(t.object.view=Object.assign({},this.view)),t}};var Ss=-90,Es=1,Ir=class extends Vt{constructor(e,t,n){super(),this.type="CubeCamera",this.renderTarget=n,this.coordinateSystem=null,this.activeMipmapLevel=0;let r=new li(Ss,Es,e,t);r.layers=this.layers,this.add(r);let s=new li(Ss,Es,e,t);s.layers=this.layers,this.add(s);let o=new li(Ss,Es,e,t);o.layers=this.layers,this.add(o);let a=new li(Ss,Es,e,t);a.layers=this.layers,this.add(a);let l=new li(Ss,Es,e,t);l.layers=this.layers,this.add(l);let c=new li(Ss,Es,e,t);c.layers=this.layers,this.add(c)}updateCoordinateSystem(){let e=this.coordinateSystem,t=this.children.concat(),[n,r,s,o,a,l]=t;for(let c of t)this.remove(c);if(e===hi)n.up.set(0,1,0),n.lookAt(1,0,0),r.up.set(0,1,0),r.lookAt(-1,0,0),s.up.set(0,0,-1),s.lookAt(0,1,0),o.up.set(0,0,1),o.lookAt(0,-1,0),a.up.set(0,1,0),a.lookAt(0,0,1),l.up.set(0,1,0),l.lookAt(0,0,-1);else if(e===vr)n.up.set(0,-1,0),n.lookAt(-1,0,0),r.up.set(0,-1,0),r.lookAt(1,0,0),s.up.set(0,0,1),s.lookAt(0,1,0),o.up.set(0,0,-1),o.lookAt(0,-1,0),a.up.set(0,-1,0),a.lookAt(0,0,1),l.up.set(0,-1,0),l.lookAt(0,0,-1);else throw new Error("THREE.CubeCamera.updateCoordinateSystem(): Invalid coordinate system: "+e);for(let c of t)this.add(c),c.updateMatrixWorld()}update(e,t){this.parent===null&&this.updateMatrixWorld();let{renderTarget:n,activeMipmapLevel:r}=this;this.coordinateSystem!==e.coordinateSystem&&(this.coordinateSystem=e.coordinateSystem,this.updateCoordinateSystem());let[s,o,a,l,c,u]=this.children,h=e.getRenderTarget(),d=e.getActiveCubeFace(),g=e.getActiveMipmapLevel(),M=e.xr.enabled;e.xr.enabled=!1;let S=n.texture.mipmapsAutoUpdate;n.texture.mipmapsAutoUpdate=!1;let _=!1;e.isWebGLRenderer===!0?_=e.state.buffers.depth.getReversed():_=e.reversedDepthBuffer,e.setRenderTarget(n,0,r),_&&e.autoClear===!1&&e.clearDepth(),e.render(t,s),e.setRenderTarget(n,1,r),_&&e.autoClear===!1&&e.clearDepth(),e.render(t,o),e.setRenderTarget(n,2,r),_&&e.autoClear===!1&&e.clearDepth(),e.render(t,a),e.setRenderTarget(n,3,r),_&&e.autoClear===!1&&e.clearDepth(),e.render(t,l),e.setRenderTarget(n,4,r),_&&e.autoClear===!1&&e.clearDepth(),e.render(t,c),n.texture.mipmapsAutoUpdate=S,e.setRenderTarget(n,5,r),_&&e.autoClear===!1&&e.clearDepth(),e.render(t,u),e.setRenderTarget(h,d,g),e.xr.enabled=M,n.texture.needsPMREMUpdate=!0}};var hl=class extends li{constructor(e=[]){super(),this.isArrayCamera=!0,this.isMultiViewCamera=!1,this.cameras=e,this.perCameraFrustumCulled=!1}};var jf=new tt,Fo=class{constructor(e,t,n=0,r=1/0){this.ray=new Yi(e,t),this.near=n,this.far=r,this.camera=null,this.layers=new er,this.params={Mesh:{},Line:{threshold:1},LOD:{},Points:{threshold:1},Sprite:{}}}set(e,t){this.ray.set(e,t)}setFromCamera(e,t){t.isPerspectiveCamera?(this.ray.origin.setFromMatrixPosition(t.matrixWorld),this.ray.direction.set(e.x,e.y,.5).unproject(t).sub(this.ray.origin).normalize(),this.camera=t):t.isOrthographicCamera?(this.ray.origin.set(e.x,e.y,t.projectionMatrix.elements[14]).unproject(t),this.ray.direction.set(0,0,-1).transformDirection(t.matrixWorld),this.camera=t):ot("Raycaster: Unsupported camera type: "+t.type)}setFromXRController(e){return jf.identity().extractRotation(e.matrixWorld),this.ray.origin.setFromMatrixPosition(e.matrixWorld),this.ray.direction.set(0,0,-1).applyMatrix4(jf),this}intersectObject(e,t=!0,n=[]){return kc(e,this,n,t),n.sort(Qf),n}intersectObjects(e,t=!0,n=[]){for(let r=0,s=e.length;r<s;r++)kc(e[r],this,n,t);return n.sort(Qf),n}};function Qf(i,e){return i.distance-e.distance}function kc(i,e,t,n){let r=!0;if(i.layers.test(e.layers)&&i.raycast(e,t)===!1&&(r=!1),r===!0&&n===!0){let s=i.children;for(let o=0,a=s.length;o<a;o++)kc(s[o],e,t,!0)}}var bs=class{constructor(e=1,t=0,n=0){this.radius=e,this.phi=t,this.theta=n}set(e,t,n){return this.radius=e,this.phi=t,this.theta=n,this}copy(e){return this.radius=e.radius,this.phi=e.phi,this.theta=e.theta,this}makeSafe(){return this.phi=Qe(this.phi,1e-6,Math.PI-1e-6),this}setFromVector3(e){return this.setFromCartesianCoords(e.x,e.y,e.z)}setFromCartesianCoords(e,t,n){return this.radius=Math.sqrt(e*e+t*t+n*n),this.radius===0?(this.theta=0,this.phi=0):(this.theta=Math.atan2(e,n),this.phi=Math.acos(Qe(t/this.radius,-1,1))),this}clone(){return new this.constructor().copy(this)}};var Do=class extends ii{constructor(e,t=null){super(),this.object=e,this.domElement=t,this.enabled=!0,this.state=-1,this.keys={},this.mouseButtons={LEFT:null,MIDDLE:null,RIGHT:null},this.touches={ONE:null,TWO:null}}connect(e){this.domElement!==null&&this.disconnect(),this.domElement=e}disconnect(){}dispose(){}update(){}};function Hc(i,e,t,n){let r=Ux(n);switch(t){case ya:return i*e;case Sa:return i*e/r.components*r.byteLength;case qr:return i*e/r.components*r.byteLength;case Vi:return i*e*2/r.components*r.byteLength;case Yr:return i*e*2/r.components*r.byteLength;case va:return i*e*3/r.components*r.byteLength;case xi:return i*e*4/r.components*r.byteLength;case $r:return i*e*4/r.components*r.byteLength;case Kr:case Zr:return Math.floor((i+3)/4)*Math.floor((e+3)/4)*8;case Jr:case jr:return Math.floor((i+3)/4)*Math.floor((e+3)/4)*16;case Ys:case Ks:return Math.max(i,16)*Math.max(e,8)/4;case qs:case $s:return Math.max(i,8)*Math.max(e,8)/2;case Zs:case Js:case Qs:case eo:return Math.floor((i+3)/4)*Math.floor((e+3)/4)*8;case js:case xr:case to:return Math.floor((i+3)/4)*Math.floor((e+3)/4)*16;case io:return Math.floor((i+3)/4)*Math.floor((e+3)/4)*16;case no:return Math.floor((i+4)/5)*Math.floor((e+3)/4)*16;case ro:return Math.floor((i+4)/5)*Math.floor((e+4)/5)*16;case so:return Math.floor((i+5)/6)*Math.floor((e+4)/5)*16;case oo:return Math.floor((i+5)/6)*Math.floor((e+5)/6)*16;case ao:return Math.floor((i+7)/8)*Math.floor((e+4)/5)*16;case lo:return Math.floor((i+7)/8)*Math.floor((e+5)/6)*16;case co:return Math.floor((i+7)/8)*Math.floor((e+7)/8)*16;case uo:return Math.floor((i+9)/10)*Math.floor((e+4)/5)*16;case fo:return Math.floor((i+9)/10)*Math.floor((e+5)/6)*16;case ho:return Math.floor((i+9)/10)*Math.floor((e+7)/8)*16;case po:return Math.floor((i+9)/10)*Math.floor((e+9)/10)*16;case mo:return Math.floor((i+11)/12)*Math.floor((e+9)/10)*16;case go:return Math.floor((i+11)/12)*Math.floor((e+11)/12)*16;case _o:case xo:case Mo:return Math.ceil(i/4)*Math.ceil(e/4)*16;case yo:case vo:return Math.ceil(i/4)*Math.ceil(e/4)*8;case Mr:case So:return Math.ceil(i/4)*Math.ceil(e/4)*16}throw new Error(`Unable to determine texture byte length for ${t} format.`)}function Ux(i){switch(i){case Kt:case ga:return{byteLength:1,components:1};case In:case _a:case ti:return{byteLength:2,components:1};case Wr:case Xr:return{byteLength:2,components:4};case ei:case Vr:case fi:return{byteLength:4,components:1};case xa:case Ma:return{byteLength:4,components:3}}throw new Error(`THREE.TextureUtils: Unknown texture type ${i}.`)}typeof __THREE_DEVTOOLS__<"u"&&__THREE_DEVTOOLS__.dispatchEvent(new CustomEvent("register",{detail:{revision:"187"}}));typeof window<"u"&&(window.__THREE__?Ce("WARNING: Multiple instances of Three.js being imported."):window.__THREE__="187");function dl(){let i=null,e=!1,t=null,n=null;function r(s,o){n=i.requestAnimationFrame(r),t(s,o)}return{start:function(){e!==!0&&t!==null&&i!==null&&(n=i.requestAnimationFrame(r),e=!0)},stop:function(){i!==null&&i.cancelAnimationFrame(n),e=!1},setAnimationLoop:function(s){t=s},setContext:function(s){i=s}}}function eh(i){let e=new WeakMap;function t(a,l){let c=a.array,u=a.usage,h=c.byteLength,d=i.createBuffer();i.bindBuffer(l,d),i.bufferData(l,c,u),a.onUploadCallback();let g;if(c instanceof Float32Array)g=i.FLOAT;else if(typeof Float16Array<"u"&&c instanceof Float16Array)g=i.HALF_FLOAT;else if(c instanceof Uint16Array)a.isFloat16BufferAttribute?g=i.HALF_FLOAT:g=i.UNSIGNED_SHORT;else if(c instanceof Int16Array)g=i.SHORT;else if(c instanceof Uint32Array)g=i.UNSIGNED_INT;else if(c instanceof Int32Array)g=i.INT;else if(c instanceof Int8Array)g=i.BYTE;else if(c instanceof Uint8Array)g=i.UNSIGNED_BYTE;else if(c instanceof Uint8ClampedArray)g=i.UNSIGNED_BYTE;else throw new Error("THREE.WebGLAttributes: Unsupported buffer data format: "+c);return{buffer:d,type:g,bytesPerElement:c.BYTES_PER_ELEMENT,version:a.version,size:h}}function n(a,l,c){let u=l.array,h=l.updateRanges;if(i.bindBuffer(c,a),h.length===0)i.bufferSubData(c,0,u);else{h.sort((g,M)=>g.start-M.start);let d=0;for(let g=1;g<h.length;g++){let M=h[d],S=h[g];S.start<=M.start+M.count+1?M.count=Math.max(M.count,S.start+S.count-M.start):(++d,h[d]=S)}h.length=d+1;for(let g=0,M=h.length;g<M;g++){let S=h[g];i.bufferSubData(c,S.start*u.BYTES_PER_ELEMENT,u,S.start,S.count)}l.clearUpdateRanges()}l.onUploadCallback()}function r(a){return a.isInterleavedBufferAttribute&&(a=a.data),e.get(a)}function s(a){a.isInterleavedBufferAttribute&&(a=a.data);let l=e.get(a);l&&(i.deleteBuffer(l.buffer),e.delete(a))}function o(a,l){if(a.isInterleavedBufferAttribute&&(a=a.data),a.isGLBufferAttribute){let u=e.get(a);(!u||u.version<a.version)&&e.set(a,{buffer:a.buffer,type:a.type,bytesPerElement:a.elementSize,version:a.version});return}let c=e.get(a);if(c===void 0)e.set(a,t(a,l));else if(c.version<a.version){if(c.size!==a.array.byteLength)throw new Error("THREE.WebGLAttributes: The size of the buffer attribute's array buffer does not match the original size. Resizing buffer attributes is not supported.");n(c.buffer,a,l),c.version=a.version}}return{get:r,remove:s,update:o}}var th=`
#ifdef USE_ALPHAHASH

	if ( diffuseColor.a < getAlphaHashThreshold( vPosition ) ) discard;

#endif
`;var ih=`
#ifdef USE_ALPHAHASH

	/**
	 * See: https://casual-effects.com/research/Wyman2017Hashed/index.html
	 */

	const float ALPHA_HASH_SCALE = 0.05; // Derived from trials only, and may be changed.

	float hash2D( vec2 value ) {

		return fract( 1.0e4 * sin( 17.0 * value.x + 0.1 * value.y ) * ( 0.1 + abs( sin( 13.0 * value.y + value.x ) ) ) );

	}

	float hash3D( vec3 value ) {

		return hash2D( vec2( hash2D( value.xy ), value.z ) );

	}

	float getAlphaHashThreshold( vec3 position ) {

		// Find the discretized derivatives of our coordinates
		float maxDeriv = max(
			length( dFdx( position.xyz ) ),
			length( dFdy( position.xyz ) )
		);
		float pixScale = 1.0 / ( ALPHA_HASH_SCALE * maxDeriv );

		// Find two nearest log-discretized noise scales
		vec2 pixScales = vec2(
			exp2( floor( log2( pixScale ) ) ),
			exp2( ceil( log2( pixScale ) ) )
		);

		// Compute alpha thresholds at our two noise scales
		vec2 alpha = vec2(
			hash3D( floor( pixScales.x * position.xyz ) ),
			hash3D( floor( pixScales.y * position.xyz ) )
		);

		// Factor to interpolate lerp with
		float lerpFactor = fract( log2( pixScale ) );

		// Interpolate alpha threshold from noise at two scales
		float x = ( 1.0 - lerpFactor ) * alpha.x + lerpFactor * alpha.y;

		// Pass into CDF to compute uniformly distrib threshold
		float a = min( lerpFactor, 1.0 - lerpFactor );
		vec3 cases = vec3(
			x * x / ( 2.0 * a * ( 1.0 - a ) ),
			( x - 0.5 * a ) / ( 1.0 - a ),
			1.0 - ( ( 1.0 - x ) * ( 1.0 - x ) / ( 2.0 * a * ( 1.0 - a ) ) )
		);

		// Find our final, uniformly distributed alpha threshold (\u03B1\u03C4)
		float threshold = ( x < ( 1.0 - a ) )
			? ( ( x < a ) ? cases.x : cases.y )
			: cases.z;

		// Avoids \u03B1\u03C4 == 0. Could also do \u03B1\u03C4 =1-\u03B1\u03C4
		return clamp( threshold , 1.0e-6, 1.0 );

	}

#endif
`;var nh=`
#ifdef USE_ALPHAMAP

	diffuseColor.a *= texture2D( alphaMap, vAlphaMapUv ).g;

#endif
`;var rh=`
#ifdef USE_ALPHAMAP

	uniform sampler2D alphaMap;

#endif
`;var sh=`
#ifdef USE_ALPHATEST

	#ifdef ALPHA_TO_COVERAGE

	diffuseColor.a = smoothstep( alphaTest, alphaTest + fwidth( diffuseColor.a ), diffuseColor.a );
	if ( diffuseColor.a == 0.0 ) discard;

	#else

	if ( diffuseColor.a < alphaTest ) discard;

	#endif

#endif
`;var oh=`
#ifdef USE_ALPHATEST
	uniform float alphaTest;
#endif
`;var ah=`
#ifdef USE_AOMAP

	// reads channel R, compatible with a combined OcclusionRoughnessMetallic (RGB) texture
	float ambientOcclusion = ( texture2D( aoMap, vAoMapUv ).r - 1.0 ) * aoMapIntensity + 1.0;

	reflectedLight.indirectDiffuse *= ambientOcclusion;

	#if defined( USE_CLEARCOAT ) 
		clearcoatSpecularIndirect *= ambientOcclusion;
	#endif

	#if defined( USE_SHEEN ) 
		sheenSpecularIndirect *= ambientOcclusion;
	#endif

	#if defined( USE_ENVMAP ) && defined( STANDARD )

		float dotNV = saturate( dot( geometryNormal, geometryViewDir ) );

		reflectedLight.indirectSpecular *= computeSpecularOcclusion( dotNV, ambientOcclusion, material.roughness );

	#endif

#endif
`;var lh=`
#ifdef USE_AOMAP

	uniform sampler2D aoMap;
	uniform float aoMapIntensity;

#endif
`;var ch=`
#ifdef USE_BATCHING
	#if ! defined( GL_ANGLE_multi_draw )
	#define gl_DrawID _gl_DrawID
	uniform int _gl_DrawID;
	#endif

	uniform highp sampler2D batchingTexture;
	uniform highp usampler2D batchingIdTexture;
	mat4 getBatchingMatrix( const in float i ) {

		int size = textureSize( batchingTexture, 0 ).x;
		int j = int( i ) * 4;
		int x = j % size;
		int y = j / size;
		vec4 v1 = texelFetch( batchingTexture, ivec2( x, y ), 0 );
		vec4 v2 = texelFetch( batchingTexture, ivec2( x + 1, y ), 0 );
		vec4 v3 = texelFetch( batchingTexture, ivec2( x + 2, y ), 0 );
		vec4 v4 = texelFetch( batchingTexture, ivec2( x + 3, y ), 0 );
		return mat4( v1, v2, v3, v4 );

	}

	float getIndirectIndex( const in int i ) {

		int size = textureSize( batchingIdTexture, 0 ).x;
		int x = i % size;
		int y = i / size;
		return float( texelFetch( batchingIdTexture, ivec2( x, y ), 0 ).r );

	}

#endif

#ifdef USE_BATCHING_COLOR

	uniform sampler2D batchingColorTexture;
	vec4 getBatchingColor( const in float i ) {

		int size = textureSize( batchingColorTexture, 0 ).x;
		int j = int( i );
		int x = j % size;
		int y = j / size;
		return texelFetch( batchingColorTexture, ivec2( x, y ), 0 );

	}

#endif
`;var uh=`
#ifdef USE_BATCHING
	mat4 batchingMatrix = getBatchingMatrix( getIndirectIndex( gl_DrawID ) );
#endif
`;var fh=`
vec3 transformed = vec3( position );

#ifdef USE_ALPHAHASH

	vPosition = vec3( position );

#endif
`;var hh=`
vec3 objectNormal = vec3( normal );

#ifdef USE_TANGENT

	vec3 objectTangent = vec3( tangent.xyz );

#endif
`;var dh=`

float G_BlinnPhong_Implicit( /* const in float dotNL, const in float dotNV */ ) {

	// geometry term is (n dot l)(n dot v) / 4(n dot l)(n dot v)
	return 0.25;

}

float D_BlinnPhong( const in float shininess, const in float dotNH ) {

	return RECIPROCAL_PI * ( shininess * 0.5 + 1.0 ) * pow( dotNH, shininess );

}

vec3 BRDF_BlinnPhong( const in vec3 lightDir, const in vec3 viewDir, const in vec3 normal, const in vec3 specularColor, const in float shininess ) {

	vec3 halfDir = normalize( lightDir + viewDir );

	float dotNH = saturate( dot( normal, halfDir ) );
	float dotVH = saturate( dot( viewDir, halfDir ) );

	vec3 F = F_Schlick( specularColor, 1.0, dotVH );

	float G = G_BlinnPhong_Implicit( /* dotNL, dotNV */ );

	float D = D_BlinnPhong( shininess, dotNH );

	return F * ( G * D );

} // validated

`;var ph="";var mh=`
#ifdef USE_BUMPMAP

	uniform sampler2D bumpMap;
	uniform float bumpScale;

	// Bump Mapping Unparametrized Surfaces on the GPU by Morten S. Mikkelsen
	// https://mmikk.github.io/papers3d/mm_sfgrad_bump.pdf

	// Evaluate the derivative of the height w.r.t. screen-space using forward differencing (listing 2)

	vec2 dHdxy_fwd() {

		vec2 dSTdx = dFdx( vBumpMapUv );
		vec2 dSTdy = dFdy( vBumpMapUv );

		float Hll = bumpScale * texture2D( bumpMap, vBumpMapUv ).x;
		float dBx = bumpScale * texture2D( bumpMap, vBumpMapUv + dSTdx ).x - Hll;
		float dBy = bumpScale * texture2D( bumpMap, vBumpMapUv + dSTdy ).x - Hll;

		return vec2( dBx, dBy );

	}

	vec3 perturbNormalArb( vec3 surf_pos, vec3 surf_norm, vec2 dHdxy, float faceDirection ) {

		// normalize is done to ensure that the bump map looks the same regardless of the texture's scale
		vec3 vSigmaX = normalize( dFdx( surf_pos.xyz ) );
		vec3 vSigmaY = normalize( dFdy( surf_pos.xyz ) );
		vec3 vN = surf_norm; // normalized

		vec3 R1 = cross( vSigmaY, vN );
		vec3 R2 = cross( vN, vSigmaX );

		float fDet = dot( vSigmaX, R1 ) * faceDirection;

		vec3 vGrad = sign( fDet ) * ( dHdxy.x * R1 + dHdxy.y * R2 );
		return normalize( abs( fDet ) * surf_norm - vGrad );

	}

#endif
`;var gh=`
#if NUM_CLIPPING_PLANES > 0

	vec4 plane;

	#ifdef ALPHA_TO_COVERAGE

		float distanceToPlane, distanceGradient;
		float clipOpacity = 1.0;

		#pragma unroll_loop_start
		for ( int i = 0; i < UNION_CLIPPING_PLANES; i ++ ) {

			plane = clippingPlanes[ i ];
			distanceToPlane = - dot( vClipPosition, plane.xyz ) + plane.w;
			distanceGradient = fwidth( distanceToPlane ) / 2.0;
			clipOpacity *= smoothstep( - distanceGradient, distanceGradient, distanceToPlane );

			if ( clipOpacity == 0.0 ) discard;

		}
		#pragma unroll_loop_end

		#if UNION_CLIPPING_PLANES < NUM_CLIPPING_PLANES

			float unionClipOpacity = 1.0;

			#pragma unroll_loop_start
			for ( int i = UNION_CLIPPING_PLANES; i < NUM_CLIPPING_PLANES; i ++ ) {

				plane = clippingPlanes[ i ];
				distanceToPlane = - dot( vClipPosition, plane.xyz ) + plane.w;
				distanceGradient = fwidth( distanceToPlane ) / 2.0;
				unionClipOpacity *= 1.0 - smoothstep( - distanceGradient, distanceGradient, distanceToPlane );

			}
			#pragma unroll_loop_end

			clipOpacity *= 1.0 - unionClipOpacity;

		#endif

		diffuseColor.a *= clipOpacity;

		if ( diffuseColor.a == 0.0 ) discard;

	#else

		#pragma unroll_loop_start
		for ( int i = 0; i < UNION_CLIPPING_PLANES; i ++ ) {

			plane = clippingPlanes[ i ];
			if ( dot( vClipPosition, plane.xyz ) > plane.w ) discard;

		}
		#pragma unroll_loop_end

		#if UNION_CLIPPING_PLANES < NUM_CLIPPING_PLANES

			bool clipped = true;

			#pragma unroll_loop_start
			for ( int i = UNION_CLIPPING_PLANES; i < NUM_CLIPPING_PLANES; i ++ ) {

				plane = clippingPlanes[ i ];
				clipped = ( dot( vClipPosition, plane.xyz ) > plane.w ) && clipped;

			}
			#pragma unroll_loop_end

			if ( clipped ) discard;

		#endif

	#endif

#endif
`;var _h=`
#if NUM_CLIPPING_PLANES > 0

	varying vec3 vClipPosition;

	uniform vec4 clippingPlanes[ NUM_CLIPPING_PLANES ];

#endif
`;var xh=`
#if NUM_CLIPPING_PLANES > 0

	varying vec3 vClipPosition;

#endif
`;var Mh=`
#if NUM_CLIPPING_PLANES > 0

	vClipPosition = - mvPosition.xyz;

#endif
`;var yh=`
#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA )

	diffuseColor *= vColor;

#endif
`;var vh=`
#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA )

	varying vec4 vColor;

#endif
`;var Sh=`
#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA ) || defined( USE_INSTANCING_COLOR ) || defined( USE_BATCHING_COLOR )

	varying vec4 vColor;

#endif
`;var Eh=`
#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA ) || defined( USE_INSTANCING_COLOR ) || defined( USE_BATCHING_COLOR )

	vColor = vec4( 1.0 );

#endif

#ifdef USE_COLOR_ALPHA

	vColor *= color;

#elif defined( USE_COLOR )

	vColor.rgb *= color;

#endif

#ifdef USE_INSTANCING_COLOR

	vColor.rgb *= instanceColor.rgb;

#endif

#ifdef USE_BATCHING_COLOR

	vColor *= getBatchingColor( getIndirectIndex( gl_DrawID ) );

#endif
`;var bh=`
#define PI 3.141592653589793
#define PI2 6.283185307179586
#define PI_HALF 1.5707963267948966
#define RECIPROCAL_PI 0.3183098861837907
#define RECIPROCAL_PI2 0.15915494309189535
#define EPSILON 1e-6

#ifndef saturate
// <tonemapping_pars_fragment> may have defined saturate() already
#define saturate( a ) clamp( a, 0.0, 1.0 )
#endif
#define whiteComplement( a ) ( 1.0 - saturate( a ) )

float pow2( const in float x ) { return x*x; }
vec3 pow2( const in vec3 x ) { return x*x; }
float pow3( const in float x ) { return x*x*x; }
float pow4( const in float x ) { float x2 = x*x; return x2*x2; }
float max3( const in vec3 v ) { return max( max( v.x, v.y ), v.z ); }
float average( const in vec3 v ) { return dot( v, vec3( 0.3333333 ) ); }

// expects values in the range of [0,1]x[0,1], returns values in the [0,1] range.
// do not collapse into a single function per: http://byteblacksmith.com/improvements-to-the-canonical-one-liner-glsl-rand-for-opengl-es-2-0/
highp float rand( const in vec2 uv ) {

	const highp float a = 12.9898, b = 78.233, c = 43758.5453;
	highp float dt = dot( uv.xy, vec2( a,b ) ), sn = mod( dt, PI );

	return fract( sin( sn ) * c );

}

#ifdef HIGH_PRECISION
	float precisionSafeLength( vec3 v ) { return length( v ); }
#else
	float precisionSafeLength( vec3 v ) {
		float maxComponent = max3( abs( v ) );
		return length( v / maxComponent ) * maxComponent;
	}
#endif

struct IncidentLight {
	vec3 color;
	vec3 direction;
	bool visible;
};

struct ReflectedLight {
	vec3 directDiffuse;
	vec3 directSpecular;
	vec3 indirectDiffuse;
	vec3 indirectSpecular;
};

#ifdef USE_ALPHAHASH

	varying vec3 vPosition;

#endif

vec3 transformDirection( in vec3 dir, in mat4 matrix ) {

	return normalize( ( matrix * vec4( dir, 0.0 ) ).xyz );

}

#define inverseTransformDirection transformDirectionByInverseViewMatrix // @deprecated r185

vec3 transformNormalByInverseViewMatrix( in vec3 normal, in mat4 viewMatrix ) {

	// upper-left 3x3 of view matrix is assumed to be orthogonal

	return normalize( ( vec4( normal, 0.0 ) * viewMatrix ).xyz );

}

vec3 transformDirectionByInverseViewMatrix( in vec3 dir, in mat4 viewMatrix ) {

	// upper-left 3x3 of view matrix is assumed to be orthogonal

	return normalize( ( vec4( dir, 0.0 ) * viewMatrix ).xyz );

}

bool isPerspectiveMatrix( mat4 m ) {

	return m[ 2 ][ 3 ] == - 1.0;

}

vec2 equirectUv( in vec3 dir ) {

	// dir is assumed to be unit length

	float u = atan( dir.z, dir.x ) * RECIPROCAL_PI2 + 0.5;

	float v = asin( clamp( dir.y, - 1.0, 1.0 ) ) * RECIPROCAL_PI + 0.5;

	return vec2( u, v );

}

vec3 BRDF_Lambert( const in vec3 diffuseColor ) {

	return RECIPROCAL_PI * diffuseColor;

} // validated

vec3 F_Schlick( const in vec3 f0, const in float f90, const in float dotVH ) {

	// Original approximation by Christophe Schlick '94
	// float fresnel = pow( 1.0 - dotVH, 5.0 );

	// Optimized variant (presented by Epic at SIGGRAPH '13)
	// https://cdn2.unrealengine.com/Resources/files/2013SiggraphPresentationsNotes-26915738.pdf
	float fresnel = exp2( ( - 5.55473 * dotVH - 6.98316 ) * dotVH );

	return f0 * ( 1.0 - fresnel ) + ( f90 * fresnel );

} // validated

float F_Schlick( const in float f0, const in float f90, const in float dotVH ) {

	// Original approximation by Christophe Schlick '94
	// float fresnel = pow( 1.0 - dotVH, 5.0 );

	// Optimized variant (presented by Epic at SIGGRAPH '13)
	// https://cdn2.unrealengine.com/Resources/files/2013SiggraphPresentationsNotes-26915738.pdf
	float fresnel = exp2( ( - 5.55473 * dotVH - 6.98316 ) * dotVH );

	return f0 * ( 1.0 - fresnel ) + ( f90 * fresnel );

} // validated
`;var Th=`

vec3 transformedNormal = objectNormal;
#ifdef USE_TANGENT

	vec3 transformedTangent = objectTangent;

#endif

#ifdef USE_BATCHING

	// this is in lieu of a per-instance normal-matrix
	// non-uniform scaling in the instance matrix is supported
	// shear transforms are not supported

	mat3 bm = mat3( batchingMatrix );
	transformedNormal /= vec3( dot( bm[ 0 ], bm[ 0 ] ), dot( bm[ 1 ], bm[ 1 ] ), dot( bm[ 2 ], bm[ 2 ] ) );
	transformedNormal = bm * transformedNormal;

	#ifdef USE_TANGENT

		transformedTangent = bm * transformedTangent;

	#endif

#endif

#ifdef USE_INSTANCING

	// this is in lieu of a per-instance normal-matrix
	// non-uniform scaling in the instance matrix is supported
	// shear transforms are not supported

	mat3 im = mat3( instanceMatrix );
	transformedNormal /= vec3( dot( im[ 0 ], im[ 0 ] ), dot( im[ 1 ], im[ 1 ] ), dot( im[ 2 ], im[ 2 ] ) );
	transformedNormal = im * transformedNormal;

	#ifdef USE_TANGENT

		transformedTangent = im * transformedTangent;

	#endif

#endif

transformedNormal = normalMatrix * transformedNormal;

#ifdef FLIP_SIDED

	transformedNormal = - transformedNormal;

#endif

#ifdef USE_TANGENT

	transformedTangent = ( modelViewMatrix * vec4( transformedTangent, 0.0 ) ).xyz;

#endif
`;var Ah=`
#ifdef USE_DISPLACEMENTMAP

	uniform sampler2D displacementMap;
	uniform float displacementScale;
	uniform float displacementBias;

#endif
`;var Rh=`
#ifdef USE_DISPLACEMENTMAP

	transformed += normalize( objectNormal ) * ( texture2D( displacementMap, vDisplacementMapUv ).x * displacementScale + displacementBias );

#endif
`;var wh=`
#ifdef USE_EMISSIVEMAP

	vec4 emissiveColor = texture2D( emissiveMap, vEmissiveMapUv );

	#ifdef DECODE_VIDEO_TEXTURE_EMISSIVE

		// use inline sRGB decode until browsers properly support SRGB8_ALPHA8 with video textures (#26516)

		emissiveColor = sRGBTransferEOTF( emissiveColor );

	#endif

	totalEmissiveRadiance *= emissiveColor.rgb;

#endif
`;var Ch=`
#ifdef USE_EMISSIVEMAP

	uniform sampler2D emissiveMap;

#endif
`;var Ph=`
gl_FragColor = linearToOutputTexel( gl_FragColor );
`;var Fh=`

vec4 LinearTransferOETF( in vec4 value ) {
	return value;
}

vec4 sRGBTransferEOTF( in vec4 value ) {
	return vec4( mix( pow( value.rgb * 0.9478672986 + vec3( 0.0521327014 ), vec3( 2.4 ) ), value.rgb * 0.0773993808, vec3( lessThanEqual( value.rgb, vec3( 0.04045 ) ) ) ), value.a );
}

vec4 sRGBTransferOETF( in vec4 value ) {
	return vec4( mix( pow( value.rgb, vec3( 0.41666 ) ) * 1.055 - vec3( 0.055 ), value.rgb * 12.92, vec3( lessThanEqual( value.rgb, vec3( 0.0031308 ) ) ) ), value.a );
}

`;var Dh=`
#ifdef USE_ENVMAP

	#ifdef ENV_WORLDPOS

		vec3 cameraToFrag;

		if ( isOrthographic ) {

			cameraToFrag = normalize( vec3( - viewMatrix[ 0 ][ 2 ], - viewMatrix[ 1 ][ 2 ], - viewMatrix[ 2 ][ 2 ] ) );

		} else {

			cameraToFrag = normalize( vWorldPosition - cameraPosition );

		}

		// Transforming Normal Vectors with the Inverse Transformation
		vec3 worldNormal = transformNormalByInverseViewMatrix( normal, viewMatrix );

		#ifdef ENVMAP_MODE_REFLECTION

			vec3 reflectVec = reflect( cameraToFrag, worldNormal );

		#else

			vec3 reflectVec = refract( cameraToFrag, worldNormal, refractionRatio );

		#endif

	#else

		vec3 reflectVec = vReflect;

	#endif

	#ifdef ENVMAP_TYPE_CUBE

		vec4 envColor = textureCube( envMap, envMapRotation * reflectVec );

		#ifdef ENVMAP_BLENDING_MULTIPLY

			outgoingLight = mix( outgoingLight, outgoingLight * envColor.xyz, specularStrength * reflectivity );

		#elif defined( ENVMAP_BLENDING_MIX )

			outgoingLight = mix( outgoingLight, envColor.xyz, specularStrength * reflectivity );

		#elif defined( ENVMAP_BLENDING_ADD )

			outgoingLight += envColor.xyz * specularStrength * reflectivity;

		#endif

	#endif

#endif
`;var Lh=`
#ifdef USE_ENVMAP

	uniform float envMapIntensity;
	uniform mat3 envMapRotation;
	uniform samplerCube envMap;

	#ifdef ENVMAP_TYPE_PMREM

		// Invert PMREMGenerator.lodToRoughness(). Matches Filament's perceptualRoughnessToLod().
		// https://github.com/google/filament/blob/main/shaders/src/surface_light_indirect.fs
		float roughnessToMip( const in float roughness ) {

			float r = clamp( roughness, 0.0, 1.0 );

			return ENVMAP_MAX_LOD * r * ( 2.0 - r );

		}

	#endif

#endif
`;var Uh=`
#ifdef USE_ENVMAP

	uniform float reflectivity;

	#if defined( USE_BUMPMAP ) || defined( USE_NORMALMAP ) || defined( PHONG ) || defined( LAMBERT )

		#define ENV_WORLDPOS

	#endif

	#ifdef ENV_WORLDPOS

		varying vec3 vWorldPosition;
		uniform float refractionRatio;
	#else
		varying vec3 vReflect;
	#endif

#endif
`;var Ih=`
#ifdef USE_ENVMAP

	#if defined( USE_BUMPMAP ) || defined( USE_NORMALMAP ) || defined( PHONG ) || defined( LAMBERT )

		#define ENV_WORLDPOS

	#endif

	#ifdef ENV_WORLDPOS
		
		varying vec3 vWorldPosition;

	#else

		varying vec3 vReflect;
		uniform float refractionRatio;

	#endif

#endif
`;var Oh=`
#ifdef USE_ENVMAP

	#ifdef ENV_WORLDPOS

		vWorldPosition = worldPosition.xyz;

	#else

		vec3 cameraToVertex;

		if ( isOrthographic ) {

			cameraToVertex = normalize( vec3( - viewMatrix[ 0 ][ 2 ], - viewMatrix[ 1 ][ 2 ], - viewMatrix[ 2 ][ 2 ] ) );

		} else {

			cameraToVertex = normalize( worldPosition.xyz - cameraPosition );

		}

		vec3 worldNormal = transformNormalByInverseViewMatrix( transformedNormal, viewMatrix );

		#ifdef ENVMAP_MODE_REFLECTION

			vReflect = reflect( cameraToVertex, worldNormal );

		#else

			vReflect = refract( cameraToVertex, worldNormal, refractionRatio );

		#endif

	#endif

#endif
`;var Nh=`
#ifdef USE_FOG

	vFogDepth = - mvPosition.z;

#endif
`;var Bh=`
#ifdef USE_FOG

	varying float vFogDepth;

#endif
`;var Gh=`
#ifdef USE_FOG

	#ifdef FOG_EXP2

		float fogFactor = 1.0 - exp( - fogDensity * fogDensity * vFogDepth * vFogDepth );

	#else

		float fogFactor = smoothstep( fogNear, fogFar, vFogDepth );

	#endif

	gl_FragColor.rgb = mix( gl_FragColor.rgb, fogColor, fogFactor );

#endif
`;var zh=`
#ifdef USE_FOG

	uniform vec3 fogColor;
	varying float vFogDepth;

	#ifdef FOG_EXP2

		uniform float fogDensity;

	#else

		uniform float fogNear;
		uniform float fogFar;

	#endif

#endif
`;var kh=`

#ifdef USE_GRADIENTMAP

	uniform sampler2D gradientMap;

#endif

vec3 getGradientIrradiance( vec3 normal, vec3 lightDirection ) {

	// dotNL will be from -1.0 to 1.0
	float dotNL = dot( normal, lightDirection );
	vec2 coord = vec2( dotNL * 0.5 + 0.5, 0.0 );

	#ifdef USE_GRADIENTMAP

		return vec3( texture2D( gradientMap, coord ).r );

	#else

		vec2 fw = fwidth( coord ) * 0.5;
		return mix( vec3( 0.7 ), vec3( 1.0 ), smoothstep( 0.7 - fw.x, 0.7 + fw.x, coord.x ) );

	#endif

}
`;var Hh=`
#ifdef USE_LIGHTMAP

	uniform sampler2D lightMap;
	uniform float lightMapIntensity;

#endif
`;var Vh="";var Wh="";var Xh="";var qh=`
#ifdef USE_ENVMAP

	vec3 getIBLIrradiance( const in vec3 normal ) {

		#ifdef ENVMAP_TYPE_PMREM

			vec3 worldNormal = transformNormalByInverseViewMatrix( normal, viewMatrix );

			vec4 envMapColor = textureLod( envMap, envMapRotation * worldNormal, ENVMAP_MAX_LOD );

			return PI * envMapColor.rgb * envMapIntensity;

		#else

			return vec3( 0.0 );

		#endif

	}

	vec3 getIBLRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness ) {

		#ifdef ENVMAP_TYPE_PMREM

			vec3 reflectVec = reflect( - viewDir, normal );

			// Mixing the reflection with the normal is more accurate and keeps rough objects from gathering light from behind their tangent plane.
			reflectVec = normalize( mix( reflectVec, normal, pow4( roughness ) ) );

			reflectVec = transformDirectionByInverseViewMatrix( reflectVec, viewMatrix );

			vec4 envMapColor = textureLod( envMap, envMapRotation * reflectVec, roughnessToMip( roughness ) );

			return envMapColor.rgb * envMapIntensity;

		#else

			return vec3( 0.0 );

		#endif

	}

	#ifdef USE_RETROREFLECTION

		vec3 getIBLRetroRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness ) {

			#ifdef ENVMAP_TYPE_PMREM

				// The retroreflective lobe returns light toward its source, so the environment is sampled along the view direction
				vec3 retroVec = normalize( mix( viewDir, normal, pow4( roughness ) ) );

				retroVec = transformDirectionByInverseViewMatrix( retroVec, viewMatrix );

				vec4 envMapColor = textureLod( envMap, envMapRotation * retroVec, roughnessToMip( roughness ) );

				return envMapColor.rgb * envMapIntensity;

			#else

				return vec3( 0.0 );

			#endif

		}

	#endif

	#ifdef USE_ANISOTROPY

		vec3 getIBLAnisotropyRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness, const in vec3 bitangent, const in float anisotropy ) {

			#ifdef ENVMAP_TYPE_PMREM

			  // https://google.github.io/filament/Filament.md.html#lighting/imagebasedlights/anisotropy
				vec3 bentNormal = cross( bitangent, viewDir );
				bentNormal = normalize( cross( bentNormal, bitangent ) );
				bentNormal = normalize( mix( bentNormal, normal, pow2( pow2( 1.0 - anisotropy * ( 1.0 - roughness ) ) ) ) );

				return getIBLRadiance( viewDir, bentNormal, roughness );

			#else

				return vec3( 0.0 );

			#endif

		}

		#ifdef USE_RETROREFLECTION

			vec3 getIBLAnisotropyRetroRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness, const in vec3 bitangent, const in float anisotropy ) {

				#ifdef ENVMAP_TYPE_PMREM

				  // https://google.github.io/filament/Filament.md.html#lighting/imagebasedlights/anisotropy
					vec3 bentNormal = cross( bitangent, viewDir );
					bentNormal = normalize( cross( bentNormal, bitangent ) );
					bentNormal = normalize( mix( bentNormal, normal, pow2( pow2( 1.0 - anisotropy * ( 1.0 - roughness ) ) ) ) );

					return getIBLRetroRadiance( viewDir, bentNormal, roughness );

				#else

					return vec3( 0.0 );

				#endif

			}

		#endif

	#endif

#endif
`;var Yh="";var $h="";var Kh="";var Zh="";var Jh="";var jh="";var Qh="";var ed="";var td="";var id=`
#if NUM_LIGHT_PROBE_GRIDS > 0

// Single atlas 3D texture that stores all 7 SH sub-volumes stacked along Z.
// Atlas depth = 7 * ( nz + 2 ) where nz = probesResolution.z.
// Each sub-volume occupies ( nz + 2 ) slices: 1 padding + nz data + 1 padding.
// Padding is a copy of the first / last data slice and prevents color bleeding
// when the hardware linear filter reads across a sub-volume boundary.
uniform highp sampler3D probesSH[ NUM_LIGHT_PROBE_GRIDS ];

uniform vec3 probesMin[ NUM_LIGHT_PROBE_GRIDS ];
uniform vec3 probesMax[ NUM_LIGHT_PROBE_GRIDS ];
uniform vec3 probesResolution[ NUM_LIGHT_PROBE_GRIDS ];

bool isInsideLightProbeGrid( vec3 worldPos, vec3 worldNormal, vec3 probesMin, vec3 probesMax, vec3 probesResolution ) {

	vec3 spacing = ( probesMax - probesMin ) / probesResolution;
	vec3 samplePos = worldPos + worldNormal * spacing * 0.5;

	// Grow the bounds by 1% of a cell, so fragments on the bounds aren't left out by
	// precision errors or samples outside of the triangle.

	vec3 margin = spacing * 0.01;
	return all( greaterThanEqual( samplePos, probesMin - margin ) ) && all( lessThanEqual( samplePos, probesMax + margin ) );

}

vec3 getLightProbeGridIrradiance( highp sampler3D probesSH, vec3 probesMin, vec3 probesMax, vec3 probesResolution, vec3 worldPos, vec3 worldNormal ) {

	vec3 res = probesResolution;
	vec3 gridRange = probesMax - probesMin;
	vec3 probeSpacing = gridRange / res;

	// Offset sample position along normal by half a probe spacing
	vec3 samplePos = worldPos + worldNormal * probeSpacing * 0.5;

	// The bounds hold one cell per probe, so they map directly to the probe grid.
	// Clamp to the texel centers of the outermost probes (XY and Z).
	vec3 uvw = clamp( ( samplePos - probesMin ) / gridRange, 0.5 / res, 1.0 - 0.5 / res );

	// Atlas UV mapping along Z:
	//   paddedSlices = nz + 2  (1 padding texel at each end of every sub-volume)
	//   atlasDepth   = 7 * paddedSlices
	//   For sub-volume t the first DATA texel sits at atlas slice t*paddedSlices + 1.
	//   Given probe-grid texel-centre UVZ = ( iz + 0.5 ) / nz the atlas UV is:
	//     atlasUvZ = ( uvw.z * nz + t * paddedSlices + 1 ) / atlasDepth
	//
	// uvZBase encodes the nz-scaled Z plus the intra-volume offset (+ 1 for padding),
	// so adding t*paddedSlices steps to each successive sub-volume.
	float nz          = res.z;
	float paddedSlices = nz + 2.0;
	float atlasDepth  = 7.0 * paddedSlices;
	float uvZBase     = uvw.z * nz + 1.0;

	vec4 s0 = texture( probesSH, vec3( uvw.xy, ( uvZBase                       ) / atlasDepth ) );
	vec4 s1 = texture( probesSH, vec3( uvw.xy, ( uvZBase +       paddedSlices   ) / atlasDepth ) );
	vec4 s2 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 2.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s3 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 3.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s4 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 4.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s5 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 5.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s6 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 6.0 * paddedSlices   ) / atlasDepth ) );

	// Unpack 9 vec3 SH L2 coefficients
	vec3 c0 = s0.xyz;
	vec3 c1 = vec3( s0.w, s1.xy );
	vec3 c2 = vec3( s1.zw, s2.x );
	vec3 c3 = s2.yzw;
	vec3 c4 = s3.xyz;
	vec3 c5 = vec3( s3.w, s4.xy );
	vec3 c6 = vec3( s4.zw, s5.x );
	vec3 c7 = s5.yzw;
	vec3 c8 = s6.xyz;

	// Evaluate L2 irradiance
	float x = worldNormal.x, y = worldNormal.y, z = worldNormal.z;

	vec3 result = c0 * 0.886227;
	result += c1 * 2.0 * 0.511664 * y;
	result += c2 * 2.0 * 0.511664 * z;
	result += c3 * 2.0 * 0.511664 * x;
	result += c4 * 2.0 * 0.429043 * x * y;
	result += c5 * 2.0 * 0.429043 * y * z;
	result += c6 * ( 0.743125 * z * z - 0.247708 );
	result += c7 * 2.0 * 0.429043 * x * z;
	result += c8 * 0.429043 * ( x * x - y * y );

	return max( result, vec3( 0.0 ) );

}

#endif
`;var nd=`
#if defined( USE_LOGARITHMIC_DEPTH_BUFFER )

	// Doing a strict comparison with == 1.0 can cause noise artifacts
	// on some platforms. See issue #17623.
	gl_FragDepth = vIsPerspective == 0.0 ? gl_FragCoord.z : log2( vFragDepth ) * logDepthBufFC * 0.5;

#endif
`;var rd=`
#if defined( USE_LOGARITHMIC_DEPTH_BUFFER )

	uniform float logDepthBufFC;
	varying float vFragDepth;
	varying float vIsPerspective;

#endif
`;var sd=`
#ifdef USE_LOGARITHMIC_DEPTH_BUFFER

	varying float vFragDepth;
	varying float vIsPerspective;

#endif
`;var od=`
#ifdef USE_LOGARITHMIC_DEPTH_BUFFER

	vFragDepth = 1.0 + gl_Position.w;
	vIsPerspective = float( isPerspectiveMatrix( projectionMatrix ) );

#endif
`;var ad=`
#ifdef USE_MAP

	vec4 sampledDiffuseColor = texture2D( map, vMapUv );

	#ifdef DECODE_VIDEO_TEXTURE

		// use inline sRGB decode until browsers properly support SRGB8_ALPHA8 with video textures (#26516)

		sampledDiffuseColor = sRGBTransferEOTF( sampledDiffuseColor );

	#endif

	diffuseColor *= sampledDiffuseColor;

#endif
`;var ld=`
#ifdef USE_MAP

	uniform sampler2D map;

#endif
`;var cd=`
#if defined( USE_MAP ) || defined( USE_ALPHAMAP )

	#if defined( USE_POINTS_UV )

		vec2 uv = vUv;

	#else

		vec2 uv = ( uvTransform * vec3( gl_PointCoord.x, 1.0 - gl_PointCoord.y, 1 ) ).xy;

	#endif

#endif

#ifdef USE_MAP

	diffuseColor *= texture2D( map, uv );

#endif

#ifdef USE_ALPHAMAP

	diffuseColor.a *= texture2D( alphaMap, uv ).g;

#endif
`;var ud=`
#if defined( USE_POINTS_UV )

	varying vec2 vUv;

#else

	#if defined( USE_MAP ) || defined( USE_ALPHAMAP )

		uniform mat3 uvTransform;

	#endif

#endif

#ifdef USE_MAP

	uniform sampler2D map;

#endif

#ifdef USE_ALPHAMAP

	uniform sampler2D alphaMap;

#endif
`;var fd=`
float metalnessFactor = metalness;

#ifdef USE_METALNESSMAP

	vec4 texelMetalness = texture2D( metalnessMap, vMetalnessMapUv );

	// reads channel B, compatible with a combined OcclusionRoughnessMetallic (RGB) texture
	metalnessFactor *= texelMetalness.b;

#endif
`;var hd=`
#ifdef USE_METALNESSMAP

	uniform sampler2D metalnessMap;

#endif
`;var dd=`
#ifdef USE_INSTANCING_MORPH

	float morphTargetInfluences[ MORPHTARGETS_COUNT ];

	float morphTargetBaseInfluence = texelFetch( morphTexture, ivec2( 0, gl_InstanceID ), 0 ).r;

	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {

		morphTargetInfluences[i] =  texelFetch( morphTexture, ivec2( i + 1, gl_InstanceID ), 0 ).r;

	}
#endif
`;var pd=`
#if defined( USE_MORPHCOLORS )

	// morphTargetBaseInfluence is set based on BufferGeometry.morphTargetsRelative value:
	// When morphTargetsRelative is false, this is set to 1 - sum(influences); this results in normal = sum((target - base) * influence)
	// When morphTargetsRelative is true, this is set to 1; as a result, all morph targets are simply added to the base after weighting

	#if defined( USE_COLOR_ALPHA )

		vColor *= morphTargetBaseInfluence;

	#elif defined( USE_COLOR )

		vColor.rgb *= morphTargetBaseInfluence;

	#endif

	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {

		#if defined( USE_COLOR_ALPHA )

			if ( morphTargetInfluences[ i ] != 0.0 ) vColor += getMorph( gl_VertexID, i, 2 ) * morphTargetInfluences[ i ];

		#elif defined( USE_COLOR )

			if ( morphTargetInfluences[ i ] != 0.0 ) vColor.rgb += getMorph( gl_VertexID, i, 2 ).rgb * morphTargetInfluences[ i ];

		#endif

	}

#endif
`;var md=`
#ifdef USE_MORPHNORMALS

	// morphTargetBaseInfluence is set based on BufferGeometry.morphTargetsRelative value:
	// When morphTargetsRelative is false, this is set to 1 - sum(influences); this results in normal = sum((target - base) * influence)
	// When morphTargetsRelative is true, this is set to 1; as a result, all morph targets are simply added to the base after weighting
	objectNormal *= morphTargetBaseInfluence;

	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {

		if ( morphTargetInfluences[ i ] != 0.0 ) objectNormal += getMorph( gl_VertexID, i, 1 ).xyz * morphTargetInfluences[ i ];

	}

#endif
`;var gd=`
#ifdef USE_MORPHTARGETS

	#ifndef USE_INSTANCING_MORPH

		uniform float morphTargetBaseInfluence;
		uniform float morphTargetInfluences[ MORPHTARGETS_COUNT ];

	#endif

	uniform sampler2DArray morphTargetsTexture;
	uniform ivec2 morphTargetsTextureSize;

	vec4 getMorph( const in int vertexIndex, const in int morphTargetIndex, const in int offset ) {

		int texelIndex = vertexIndex * MORPHTARGETS_TEXTURE_STRIDE + offset;
		int y = texelIndex / morphTargetsTextureSize.x;
		int x = texelIndex - y * morphTargetsTextureSize.x;

		ivec3 morphUV = ivec3( x, y, morphTargetIndex );
		return texelFetch( morphTargetsTexture, morphUV, 0 );

	}

#endif
`;var _d=`
#ifdef USE_MORPHTARGETS

	// morphTargetBaseInfluence is set based on BufferGeometry.morphTargetsRelative value:
	// When morphTargetsRelative is false, this is set to 1 - sum(influences); this results in position = sum((target - base) * influence)
	// When morphTargetsRelative is true, this is set to 1; as a result, all morph targets are simply added to the base after weighting
	transformed *= morphTargetBaseInfluence;

	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {

		if ( morphTargetInfluences[ i ] != 0.0 ) transformed += getMorph( gl_VertexID, i, 0 ).xyz * morphTargetInfluences[ i ];

	}

#endif
`;var xd=`
float faceDirection = gl_FrontFacing ? 1.0 : - 1.0;

#ifdef FLAT_SHADED

	vec3 fdx = dFdx( vViewPosition );
	vec3 fdy = dFdy( vViewPosition );
	vec3 normal = normalize( cross( fdx, fdy ) );

#else

	vec3 normal = normalize( vNormal );

	#ifdef DOUBLE_SIDED

		normal *= faceDirection;

	#endif

#endif

#if defined( USE_NORMALMAP_TANGENTSPACE ) || defined( USE_CLEARCOAT_NORMALMAP ) || defined( USE_ANISOTROPY )

	#ifdef USE_TANGENT

		mat3 tbn = mat3( normalize( vTangent ), normalize( vBitangent ), normal );

	#else

		mat3 tbn = getTangentFrame( - vViewPosition, normal,
		#if defined( USE_NORMALMAP )
			vNormalMapUv
		#elif defined( USE_CLEARCOAT_NORMALMAP )
			vClearcoatNormalMapUv
		#else
			vUv
		#endif
		);

	#endif

	#ifdef DOUBLE_SIDED

		tbn[0] *= faceDirection;
		tbn[1] *= faceDirection;

	#endif

#endif

#ifdef USE_CLEARCOAT_NORMALMAP

	#ifdef USE_TANGENT

		mat3 tbn2 = mat3( normalize( vTangent ), normalize( vBitangent ), normal );

	#else

		mat3 tbn2 = getTangentFrame( - vViewPosition, normal, vClearcoatNormalMapUv );

	#endif

	#ifdef DOUBLE_SIDED

		tbn2[0] *= faceDirection;
		tbn2[1] *= faceDirection;

	#endif

#endif

// non perturbed normal for clearcoat among others

vec3 nonPerturbedNormal = normal;

`;var Md=`

#ifdef USE_NORMALMAP_OBJECTSPACE

	normal = texture2D( normalMap, vNormalMapUv ).xyz * 2.0 - 1.0; // overrides both flatShading and attribute normals

	#ifdef FLIP_SIDED

		normal = - normal;

	#endif

	#ifdef DOUBLE_SIDED

		normal = normal * faceDirection;

	#endif

	normal = normalize( normalMatrix * normal );

#elif defined( USE_NORMALMAP_TANGENTSPACE )

	vec3 mapN = texture2D( normalMap, vNormalMapUv ).xyz * 2.0 - 1.0;

	#if defined( USE_PACKED_NORMALMAP )

		mapN = vec3( mapN.xy, sqrt( saturate( 1.0 - dot( mapN.xy, mapN.xy ) ) ) );

	#endif

	mapN.xy *= normalScale;

	normal = normalize( tbn * mapN );

#elif defined( USE_BUMPMAP )

	normal = perturbNormalArb( - vViewPosition, normal, dHdxy_fwd(), faceDirection );

#endif
`;var yd=`
#ifndef FLAT_SHADED

	varying vec3 vNormal;

	#ifdef USE_TANGENT

		varying vec3 vTangent;
		varying vec3 vBitangent;

	#endif

#endif
`;var vd=`
#ifndef FLAT_SHADED

	varying vec3 vNormal;

	#ifdef USE_TANGENT

		varying vec3 vTangent;
		varying vec3 vBitangent;

	#endif

#endif
`;var Sd=`
#ifndef FLAT_SHADED // normal is computed with derivatives when FLAT_SHADED

	vNormal = normalize( transformedNormal );

	#ifdef USE_TANGENT

		vTangent = normalize( transformedTangent );
		vBitangent = normalize( cross( vNormal, vTangent ) * tangent.w );

		#ifdef FLIP_SIDED

			vBitangent = - vBitangent;

		#endif

	#endif

#endif
`;var Ed=`
#ifdef USE_NORMALMAP

	uniform sampler2D normalMap;
	uniform vec2 normalScale;

#endif

#ifdef USE_NORMALMAP_OBJECTSPACE

	uniform mat3 normalMatrix;

#endif

#if ! defined ( USE_TANGENT ) && ( defined ( USE_NORMALMAP_TANGENTSPACE ) || defined ( USE_CLEARCOAT_NORMALMAP ) || defined( USE_ANISOTROPY ) )

	// Normal Mapping Without Precomputed Tangents
	// http://www.thetenthplanet.de/archives/1180

	mat3 getTangentFrame( vec3 eye_pos, vec3 surf_norm, vec2 uv ) {

		vec3 q0 = dFdx( eye_pos.xyz );
		vec3 q1 = dFdy( eye_pos.xyz );
		vec2 st0 = dFdx( uv.st );
		vec2 st1 = dFdy( uv.st );

		vec3 N = surf_norm; // normalized

		vec3 q1perp = cross( q1, N );
		vec3 q0perp = cross( N, q0 );

		vec3 T = q1perp * st0.x + q0perp * st1.x;
		vec3 B = q1perp * st0.y + q0perp * st1.y;

		float det = max( dot( T, T ), dot( B, B ) );
		float scale = ( det == 0.0 ) ? 0.0 : inversesqrt( det );

		return mat3( T * scale, B * scale, N );

	}

#endif
`;var bd=`
#ifdef USE_CLEARCOAT

	vec3 clearcoatNormal = nonPerturbedNormal;

#endif
`;var Td=`
#ifdef USE_CLEARCOAT_NORMALMAP

	vec3 clearcoatMapN = texture2D( clearcoatNormalMap, vClearcoatNormalMapUv ).xyz * 2.0 - 1.0;
	clearcoatMapN.xy *= clearcoatNormalScale;

	clearcoatNormal = normalize( tbn2 * clearcoatMapN );

#endif
`;var Ad=`

#ifdef USE_CLEARCOATMAP

	uniform sampler2D clearcoatMap;

#endif

#ifdef USE_CLEARCOAT_NORMALMAP

	uniform sampler2D clearcoatNormalMap;
	uniform vec2 clearcoatNormalScale;

#endif

#ifdef USE_CLEARCOAT_ROUGHNESSMAP

	uniform sampler2D clearcoatRoughnessMap;

#endif
`;var Rd="";var wd=`
#ifdef OPAQUE
diffuseColor.a = 1.0;
#endif

#ifdef USE_TRANSMISSION
diffuseColor.a *= material.transmissionAlpha;
#endif

gl_FragColor = vec4( outgoingLight, diffuseColor.a );
`;var Cd=`
vec3 packNormalToRGB( const in vec3 normal ) {
	return normalize( normal ) * 0.5 + 0.5;
}

vec3 unpackRGBToNormal( const in vec3 rgb ) {
	return 2.0 * rgb.xyz - 1.0;
}

const float PackUpscale = 256. / 255.; // fraction -> 0..1 (including 1)
const float UnpackDownscale = 255. / 256.; // 0..1 -> fraction (excluding 1)
const float ShiftRight8 = 1. / 256.;
const float Inv255 = 1. / 255.;

const vec4 PackFactors = vec4( 1.0, 256.0, 256.0 * 256.0, 256.0 * 256.0 * 256.0 );

const vec2 UnpackFactors2 = vec2( UnpackDownscale, 1.0 / PackFactors.g );
const vec3 UnpackFactors3 = vec3( UnpackDownscale / PackFactors.rg, 1.0 / PackFactors.b );
const vec4 UnpackFactors4 = vec4( UnpackDownscale / PackFactors.rgb, 1.0 / PackFactors.a );

vec4 packDepthToRGBA( const in float v ) {
	if( v <= 0.0 )
		return vec4( 0., 0., 0., 0. );
	if( v >= 1.0 )
		return vec4( 1., 1., 1., 1. );
	float vuf;
	float af = modf( v * PackFactors.a, vuf );
	float bf = modf( vuf * ShiftRight8, vuf );
	float gf = modf( vuf * ShiftRight8, vuf );
	return vec4( vuf * Inv255, gf * PackUpscale, bf * PackUpscale, af );
}

vec3 packDepthToRGB( const in float v ) {
	if( v <= 0.0 )
		return vec3( 0., 0., 0. );
	if( v >= 1.0 )
		return vec3( 1., 1., 1. );
	float vuf;
	float bf = modf( v * PackFactors.b, vuf );
	float gf = modf( vuf * ShiftRight8, vuf );
	// the 0.9999 tweak is unimportant, very tiny empirical improvement
	// return vec3( vuf * Inv255, gf * PackUpscale, bf * 0.9999 );
	return vec3( vuf * Inv255, gf * PackUpscale, bf );
}

vec2 packDepthToRG( const in float v ) {
	if( v <= 0.0 )
		return vec2( 0., 0. );
	if( v >= 1.0 )
		return vec2( 1., 1. );
	float vuf;
	float gf = modf( v * 256., vuf );
	return vec2( vuf * Inv255, gf );
}

float unpackRGBAToDepth( const in vec4 v ) {
	return dot( v, UnpackFactors4 );
}

float unpackRGBToDepth( const in vec3 v ) {
	return dot( v, UnpackFactors3 );
}

float unpackRGToDepth( const in vec2 v ) {
	return v.r * UnpackFactors2.r + v.g * UnpackFactors2.g;
}

vec4 pack2HalfToRGBA( const in vec2 v ) {
	vec4 r = vec4( v.x, fract( v.x * 255.0 ), v.y, fract( v.y * 255.0 ) );
	return vec4( r.x - r.y / 255.0, r.y, r.z - r.w / 255.0, r.w );
}

vec2 unpackRGBATo2Half( const in vec4 v ) {
	return vec2( v.x + ( v.y / 255.0 ), v.z + ( v.w / 255.0 ) );
}

// NOTE: viewZ, the z-coordinate in camera space, is negative for points in front of the camera

float viewZToOrthographicDepth( const in float viewZ, const in float near, const in float far ) {
	// -near maps to 0; -far maps to 1
	return ( viewZ + near ) / ( near - far );
}

float orthographicDepthToViewZ( const in float depth, const in float near, const in float far ) {

	#ifdef USE_REVERSED_DEPTH_BUFFER
	
		return depth * ( far - near ) - far;

	#else

		return depth * ( near - far ) - near;

	#endif
}

// NOTE: https://twitter.com/gonnavis/status/1377183786949959682

float viewZToPerspectiveDepth( const in float viewZ, const in float near, const in float far ) {
	// -near maps to 0; -far maps to 1
	return ( ( near + viewZ ) * far ) / ( ( far - near ) * viewZ );
}

float perspectiveDepthToViewZ( const in float depth, const in float near, const in float far ) {
	
	#ifdef USE_REVERSED_DEPTH_BUFFER

		return ( near * far ) / ( ( near - far ) * depth - near );

	#else

		return ( near * far ) / ( ( far - near ) * depth - far );

	#endif
}
`;var Pd=`
#ifdef PREMULTIPLIED_ALPHA

	gl_FragColor.rgb *= gl_FragColor.a;

#endif
`;var Fd=`
vec4 mvPosition = vec4( transformed, 1.0 );

#ifdef USE_BATCHING

	mvPosition = batchingMatrix * mvPosition;

#endif

#ifdef USE_INSTANCING

	mvPosition = instanceMatrix * mvPosition;

#endif

mvPosition = modelViewMatrix * mvPosition;

gl_Position = projectionMatrix * mvPosition;
`;var Dd=`
#ifdef DITHERING

	gl_FragColor.rgb = dithering( gl_FragColor.rgb );

#endif
`;var Ld=`
#ifdef DITHERING

	// based on https://www.shadertoy.com/view/MslGR8
	vec3 dithering( vec3 color ) {
		//Calculate grid position
		float grid_position = rand( gl_FragCoord.xy );

		//Shift the individual colors differently, thus making it even harder to see the dithering pattern
		vec3 dither_shift_RGB = vec3( 0.25 / 255.0, -0.25 / 255.0, 0.25 / 255.0 );

		//modify shift according to grid position.
		dither_shift_RGB = mix( 2.0 * dither_shift_RGB, -2.0 * dither_shift_RGB, grid_position );

		//shift the color by dither_shift
		return color + dither_shift_RGB;
	}

#endif
`;var Ud=`
float roughnessFactor = roughness;

#ifdef USE_ROUGHNESSMAP

	vec4 texelRoughness = texture2D( roughnessMap, vRoughnessMapUv );

	// reads channel G, compatible with a combined OcclusionRoughnessMetallic (RGB) texture
	roughnessFactor *= texelRoughness.g;

#endif
`;var Id=`
#ifdef USE_ROUGHNESSMAP

	uniform sampler2D roughnessMap;

#endif
`;var Od="";var Nd="";var Bd="";var Gd="";var zd=`
#ifdef USE_SKINNING

	mat4 boneMatX = getBoneMatrix( skinIndex.x );
	mat4 boneMatY = getBoneMatrix( skinIndex.y );
	mat4 boneMatZ = getBoneMatrix( skinIndex.z );
	mat4 boneMatW = getBoneMatrix( skinIndex.w );

#endif
`;var kd=`
#ifdef USE_SKINNING

	uniform mat4 bindMatrix;
	uniform mat4 bindMatrixInverse;

	uniform highp sampler2D boneTexture;

	mat4 getBoneMatrix( const in float i ) {

		int size = textureSize( boneTexture, 0 ).x;
		int j = int( i ) * 4;
		int x = j % size;
		int y = j / size;
		vec4 v1 = texelFetch( boneTexture, ivec2( x, y ), 0 );
		vec4 v2 = texelFetch( boneTexture, ivec2( x + 1, y ), 0 );
		vec4 v3 = texelFetch( boneTexture, ivec2( x + 2, y ), 0 );
		vec4 v4 = texelFetch( boneTexture, ivec2( x + 3, y ), 0 );

		return mat4( v1, v2, v3, v4 );

	}

#endif
`;var Hd=`
#ifdef USE_SKINNING

	vec4 skinVertex = bindMatrix * vec4( transformed, 1.0 );

	vec4 skinned = vec4( 0.0 );
	skinned += boneMatX * skinVertex * skinWeight.x;
	skinned += boneMatY * skinVertex * skinWeight.y;
	skinned += boneMatZ * skinVertex * skinWeight.z;
	skinned += boneMatW * skinVertex * skinWeight.w;

	transformed = ( bindMatrixInverse * skinned ).xyz;

#endif
`;var Vd=`
#ifdef USE_SKINNING

	mat4 skinMatrix = mat4( 0.0 );
	skinMatrix += skinWeight.x * boneMatX;
	skinMatrix += skinWeight.y * boneMatY;
	skinMatrix += skinWeight.z * boneMatZ;
	skinMatrix += skinWeight.w * boneMatW;
	skinMatrix = bindMatrixInverse * skinMatrix * bindMatrix;

	objectNormal = vec4( skinMatrix * vec4( objectNormal, 0.0 ) ).xyz;

	#ifdef USE_TANGENT

		objectTangent = vec4( skinMatrix * vec4( objectTangent, 0.0 ) ).xyz;

	#endif

#endif
`;var Wd=`
float specularStrength;

#ifdef USE_SPECULARMAP

	vec4 texelSpecular = texture2D( specularMap, vSpecularMapUv );
	specularStrength = texelSpecular.r;

#else

	specularStrength = 1.0;

#endif
`;var Xd=`
#ifdef USE_SPECULARMAP

	uniform sampler2D specularMap;

#endif
`;var qd=`
#if defined( TONE_MAPPING )

	gl_FragColor.rgb = toneMapping( gl_FragColor.rgb );

#endif
`;var Yd=`
#ifndef saturate
// <common> may have defined saturate() already
#define saturate( a ) clamp( a, 0.0, 1.0 )
#endif

uniform float toneMappingExposure;

// exposure only
vec3 LinearToneMapping( vec3 color ) {

	return saturate( toneMappingExposure * color );

}

// source: https://www.cs.utah.edu/docs/techreports/2002/pdf/UUCS-02-001.pdf
vec3 ReinhardToneMapping( vec3 color ) {

	color *= toneMappingExposure;
	return saturate( color / ( vec3( 1.0 ) + color ) );

}

// source: http://filmicworlds.com/blog/filmic-tonemapping-operators/
vec3 CineonToneMapping( vec3 color ) {

	// filmic operator by Jim Hejl and Richard Burgess-Dawson
	color *= toneMappingExposure;
	color = max( vec3( 0.0 ), color - 0.004 );
	return pow( ( color * ( 6.2 * color + 0.5 ) ) / ( color * ( 6.2 * color + 1.7 ) + 0.06 ), vec3( 2.2 ) );

}

// source: https://github.com/selfshadow/ltc_code/blob/master/webgl/shaders/ltc/ltc_blit.fs
vec3 RRTAndODTFit( vec3 v ) {

	vec3 a = v * ( v + 0.0245786 ) - 0.000090537;
	vec3 b = v * ( 0.983729 * v + 0.4329510 ) + 0.238081;
	return a / b;

}

// this implementation of ACES is modified to accommodate a brighter viewing environment.
// the scale factor of 1/0.6 is subjective. see discussion in #19621.

vec3 ACESFilmicToneMapping( vec3 color ) {

	// sRGB => XYZ => D65_2_D60 => AP1 => RRT_SAT
	const mat3 ACESInputMat = mat3(
		vec3( 0.59719, 0.07600, 0.02840 ), // transposed from source
		vec3( 0.35458, 0.90834, 0.13383 ),
		vec3( 0.04823, 0.01566, 0.83777 )
	);

	// ODT_SAT => XYZ => D60_2_D65 => sRGB
	const mat3 ACESOutputMat = mat3(
		vec3(  1.60475, -0.10208, -0.00327 ), // transposed from source
		vec3( -0.53108,  1.10813, -0.07276 ),
		vec3( -0.07367, -0.00605,  1.07602 )
	);

	color *= toneMappingExposure / 0.6;

	color = ACESInputMat * color;

	// Apply RRT and ODT
	color = RRTAndODTFit( color );

	color = ACESOutputMat * color;

	// Clamp to [0, 1]
	return saturate( color );

}

// Matrices for rec 2020 <> rec 709 color space conversion
// matrix provided in row-major order so it has been transposed
// https://www.itu.int/pub/R-REP-BT.2407-2017
const mat3 LINEAR_REC2020_TO_LINEAR_SRGB = mat3(
	vec3( 1.6605, - 0.1246, - 0.0182 ),
	vec3( - 0.5876, 1.1329, - 0.1006 ),
	vec3( - 0.0728, - 0.0083, 1.1187 )
);

const mat3 LINEAR_SRGB_TO_LINEAR_REC2020 = mat3(
	vec3( 0.6274, 0.0691, 0.0164 ),
	vec3( 0.3293, 0.9195, 0.0880 ),
	vec3( 0.0433, 0.0113, 0.8956 )
);

// https://iolite-engine.com/blog_posts/minimal_agx_implementation
// Mean error^2: 3.6705141e-06
vec3 agxDefaultContrastApprox( vec3 x ) {

	vec3 x2 = x * x;
	vec3 x4 = x2 * x2;

	return + 15.5 * x4 * x2
		- 40.14 * x4 * x
		+ 31.96 * x4
		- 6.868 * x2 * x
		+ 0.4298 * x2
		+ 0.1191 * x
		- 0.00232;

}

// AgX Tone Mapping implementation based on Filament, which in turn is based
// on Blender's implementation using rec 2020 primaries
// https://github.com/google/filament/pull/7236
// Inputs and outputs are encoded as Linear-sRGB.

vec3 AgXToneMapping( vec3 color ) {

	// AgX constants
	const mat3 AgXInsetMatrix = mat3(
		vec3( 0.856627153315983, 0.137318972929847, 0.11189821299995 ),
		vec3( 0.0951212405381588, 0.761241990602591, 0.0767994186031903 ),
		vec3( 0.0482516061458583, 0.101439036467562, 0.811302368396859 )
	);

	// explicit AgXOutsetMatrix generated from Filaments AgXOutsetMatrixInv
	const mat3 AgXOutsetMatrix = mat3(
		vec3( 1.1271005818144368, - 0.1413297634984383, - 0.14132976349843826 ),
		vec3( - 0.11060664309660323, 1.157823702216272, - 0.11060664309660294 ),
		vec3( - 0.016493938717834573, - 0.016493938717834257, 1.2519364065950405 )
	);

	// LOG2_MIN      = -10.0
	// LOG2_MAX      =  +6.5
	// MIDDLE_GRAY   =  0.18
	const float AgxMinEv = - 12.47393;  // log2( pow( 2, LOG2_MIN ) * MIDDLE_GRAY )
	const float AgxMaxEv = 4.026069;    // log2( pow( 2, LOG2_MAX ) * MIDDLE_GRAY )

	color *= toneMappingExposure;

	color = LINEAR_SRGB_TO_LINEAR_REC2020 * color;

	color = AgXInsetMatrix * color;

	// Log2 encoding
	color = max( color, 1e-10 ); // avoid 0 or negative numbers for log2
	color = log2( color );
	color = ( color - AgxMinEv ) / ( AgxMaxEv - AgxMinEv );

	color = clamp( color, 0.0, 1.0 );

	// Apply sigmoid
	color = agxDefaultContrastApprox( color );

	// Apply AgX look
	// v = agxLook(v, look);

	color = AgXOutsetMatrix * color;

	// Linearize
	color = pow( max( vec3( 0.0 ), color ), vec3( 2.2 ) );

	color = LINEAR_REC2020_TO_LINEAR_SRGB * color;

	// Gamut mapping. Simple clamp for now.
	color = clamp( color, 0.0, 1.0 );

	return color;

}

// https://modelviewer.dev/examples/tone-mapping

vec3 NeutralToneMapping( vec3 color ) {

	const float StartCompression = 0.8 - 0.04;
	const float Desaturation = 0.15;

	color *= toneMappingExposure;

	float x = min( color.r, min( color.g, color.b ) );

	float offset = x < 0.08 ? x - 6.25 * x * x : 0.04;

	color -= offset;

	float peak = max( color.r, max( color.g, color.b ) );

	if ( peak < StartCompression ) return color;

	float d = 1. - StartCompression;

	float newPeak = 1. - d * d / ( peak + d - StartCompression );

	color *= newPeak / peak;

	float g = 1. - 1. / ( Desaturation * ( peak - newPeak ) + 1. );

	return mix( color, vec3( newPeak ), g );

}

vec3 CustomToneMapping( vec3 color ) { return color; }
`;var $d="";var Kd="";var Zd=`
#if defined( USE_UV ) || defined( USE_ANISOTROPY )

	varying vec2 vUv;

#endif
#ifdef USE_MAP

	varying vec2 vMapUv;

#endif
#ifdef USE_ALPHAMAP

	varying vec2 vAlphaMapUv;

#endif
#ifdef USE_LIGHTMAP

	varying vec2 vLightMapUv;

#endif
#ifdef USE_AOMAP

	varying vec2 vAoMapUv;

#endif
#ifdef USE_BUMPMAP

	varying vec2 vBumpMapUv;

#endif
#ifdef USE_NORMALMAP

	varying vec2 vNormalMapUv;

#endif
#ifdef USE_EMISSIVEMAP

	varying vec2 vEmissiveMapUv;

#endif
#ifdef USE_METALNESSMAP

	varying vec2 vMetalnessMapUv;

#endif
#ifdef USE_ROUGHNESSMAP

	varying vec2 vRoughnessMapUv;

#endif
#ifdef USE_DIFFUSE_ROUGHNESSMAP

	varying vec2 vDiffuseRoughnessMapUv;

#endif
#ifdef USE_ANISOTROPYMAP

	varying vec2 vAnisotropyMapUv;

#endif
#ifdef USE_CLEARCOATMAP

	varying vec2 vClearcoatMapUv;

#endif
#ifdef USE_CLEARCOAT_NORMALMAP

	varying vec2 vClearcoatNormalMapUv;

#endif
#ifdef USE_CLEARCOAT_ROUGHNESSMAP

	varying vec2 vClearcoatRoughnessMapUv;

#endif
#ifdef USE_IRIDESCENCEMAP

	varying vec2 vIridescenceMapUv;

#endif
#ifdef USE_IRIDESCENCE_THICKNESSMAP

	varying vec2 vIridescenceThicknessMapUv;

#endif
#ifdef USE_SHEEN_COLORMAP

	varying vec2 vSheenColorMapUv;

#endif
#ifdef USE_SHEEN_ROUGHNESSMAP

	varying vec2 vSheenRoughnessMapUv;

#endif
#ifdef USE_SPECULARMAP

	varying vec2 vSpecularMapUv;

#endif
#ifdef USE_SPECULAR_COLORMAP

	varying vec2 vSpecularColorMapUv;

#endif
#ifdef USE_SPECULAR_INTENSITYMAP

	varying vec2 vSpecularIntensityMapUv;

#endif
#ifdef USE_TRANSMISSIONMAP

	uniform mat3 transmissionMapTransform;
	varying vec2 vTransmissionMapUv;

#endif
#ifdef USE_THICKNESSMAP

	uniform mat3 thicknessMapTransform;
	varying vec2 vThicknessMapUv;

#endif
`;var Jd=`
#if defined( USE_UV ) || defined( USE_ANISOTROPY )

	varying vec2 vUv;

#endif
#ifdef USE_MAP

	uniform mat3 mapTransform;
	varying vec2 vMapUv;

#endif
#ifdef USE_ALPHAMAP

	uniform mat3 alphaMapTransform;
	varying vec2 vAlphaMapUv;

#endif
#ifdef USE_LIGHTMAP

	uniform mat3 lightMapTransform;
	varying vec2 vLightMapUv;

#endif
#ifdef USE_AOMAP

	uniform mat3 aoMapTransform;
	varying vec2 vAoMapUv;

#endif
#ifdef USE_BUMPMAP

	uniform mat3 bumpMapTransform;
	varying vec2 vBumpMapUv;

#endif
#ifdef USE_NORMALMAP

	uniform mat3 normalMapTransform;
	varying vec2 vNormalMapUv;

#endif
#ifdef USE_DISPLACEMENTMAP

	uniform mat3 displacementMapTransform;
	varying vec2 vDisplacementMapUv;

#endif
#ifdef USE_EMISSIVEMAP

	uniform mat3 emissiveMapTransform;
	varying vec2 vEmissiveMapUv;

#endif
#ifdef USE_METALNESSMAP

	uniform mat3 metalnessMapTransform;
	varying vec2 vMetalnessMapUv;

#endif
#ifdef USE_ROUGHNESSMAP

	uniform mat3 roughnessMapTransform;
	varying vec2 vRoughnessMapUv;

#endif
#ifdef USE_DIFFUSE_ROUGHNESSMAP

	uniform mat3 diffuseRoughnessMapTransform;
	varying vec2 vDiffuseRoughnessMapUv;

#endif
#ifdef USE_ANISOTROPYMAP

	uniform mat3 anisotropyMapTransform;
	varying vec2 vAnisotropyMapUv;

#endif
#ifdef USE_CLEARCOATMAP

	uniform mat3 clearcoatMapTransform;
	varying vec2 vClearcoatMapUv;

#endif
#ifdef USE_CLEARCOAT_NORMALMAP

	uniform mat3 clearcoatNormalMapTransform;
	varying vec2 vClearcoatNormalMapUv;

#endif
#ifdef USE_CLEARCOAT_ROUGHNESSMAP

	uniform mat3 clearcoatRoughnessMapTransform;
	varying vec2 vClearcoatRoughnessMapUv;

#endif
#ifdef USE_SHEEN_COLORMAP

	uniform mat3 sheenColorMapTransform;
	varying vec2 vSheenColorMapUv;

#endif
#ifdef USE_SHEEN_ROUGHNESSMAP

	uniform mat3 sheenRoughnessMapTransform;
	varying vec2 vSheenRoughnessMapUv;

#endif
#ifdef USE_IRIDESCENCEMAP

	uniform mat3 iridescenceMapTransform;
	varying vec2 vIridescenceMapUv;

#endif
#ifdef USE_IRIDESCENCE_THICKNESSMAP

	uniform mat3 iridescenceThicknessMapTransform;
	varying vec2 vIridescenceThicknessMapUv;

#endif
#ifdef USE_SPECULARMAP

	uniform mat3 specularMapTransform;
	varying vec2 vSpecularMapUv;

#endif
#ifdef USE_SPECULAR_COLORMAP

	uniform mat3 specularColorMapTransform;
	varying vec2 vSpecularColorMapUv;

#endif
#ifdef USE_SPECULAR_INTENSITYMAP

	uniform mat3 specularIntensityMapTransform;
	varying vec2 vSpecularIntensityMapUv;

#endif
#ifdef USE_TRANSMISSIONMAP

	uniform mat3 transmissionMapTransform;
	varying vec2 vTransmissionMapUv;

#endif
#ifdef USE_THICKNESSMAP

	uniform mat3 thicknessMapTransform;
	varying vec2 vThicknessMapUv;

#endif
`;var jd=`
#if defined( USE_UV ) || defined( USE_ANISOTROPY )

	vUv = vec3( uv, 1 ).xy;

#endif
#ifdef USE_MAP

	vMapUv = ( mapTransform * vec3( MAP_UV, 1 ) ).xy;

#endif
#ifdef USE_ALPHAMAP

	vAlphaMapUv = ( alphaMapTransform * vec3( ALPHAMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_LIGHTMAP

	vLightMapUv = ( lightMapTransform * vec3( LIGHTMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_AOMAP

	vAoMapUv = ( aoMapTransform * vec3( AOMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_BUMPMAP

	vBumpMapUv = ( bumpMapTransform * vec3( BUMPMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_NORMALMAP

	vNormalMapUv = ( normalMapTransform * vec3( NORMALMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_DISPLACEMENTMAP

	vDisplacementMapUv = ( displacementMapTransform * vec3( DISPLACEMENTMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_EMISSIVEMAP

	vEmissiveMapUv = ( emissiveMapTransform * vec3( EMISSIVEMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_METALNESSMAP

	vMetalnessMapUv = ( metalnessMapTransform * vec3( METALNESSMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_ROUGHNESSMAP

	vRoughnessMapUv = ( roughnessMapTransform * vec3( ROUGHNESSMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_DIFFUSE_ROUGHNESSMAP

	vDiffuseRoughnessMapUv = ( diffuseRoughnessMapTransform * vec3( DIFFUSE_ROUGHNESSMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_ANISOTROPYMAP

	vAnisotropyMapUv = ( anisotropyMapTransform * vec3( ANISOTROPYMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_CLEARCOATMAP

	vClearcoatMapUv = ( clearcoatMapTransform * vec3( CLEARCOATMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_CLEARCOAT_NORMALMAP

	vClearcoatNormalMapUv = ( clearcoatNormalMapTransform * vec3( CLEARCOAT_NORMALMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_CLEARCOAT_ROUGHNESSMAP

	vClearcoatRoughnessMapUv = ( clearcoatRoughnessMapTransform * vec3( CLEARCOAT_ROUGHNESSMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_IRIDESCENCEMAP

	vIridescenceMapUv = ( iridescenceMapTransform * vec3( IRIDESCENCEMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_IRIDESCENCE_THICKNESSMAP

	vIridescenceThicknessMapUv = ( iridescenceThicknessMapTransform * vec3( IRIDESCENCE_THICKNESSMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_SHEEN_COLORMAP

	vSheenColorMapUv = ( sheenColorMapTransform * vec3( SHEEN_COLORMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_SHEEN_ROUGHNESSMAP

	vSheenRoughnessMapUv = ( sheenRoughnessMapTransform * vec3( SHEEN_ROUGHNESSMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_SPECULARMAP

	vSpecularMapUv = ( specularMapTransform * vec3( SPECULARMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_SPECULAR_COLORMAP

	vSpecularColorMapUv = ( specularColorMapTransform * vec3( SPECULAR_COLORMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_SPECULAR_INTENSITYMAP

	vSpecularIntensityMapUv = ( specularIntensityMapTransform * vec3( SPECULAR_INTENSITYMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_TRANSMISSIONMAP

	vTransmissionMapUv = ( transmissionMapTransform * vec3( TRANSMISSIONMAP_UV, 1 ) ).xy;

#endif
#ifdef USE_THICKNESSMAP

	vThicknessMapUv = ( thicknessMapTransform * vec3( THICKNESSMAP_UV, 1 ) ).xy;

#endif
`;var Qd=`
#if defined( USE_ENVMAP ) || defined( DISTANCE ) || defined ( USE_SHADOWMAP ) || defined ( USE_TRANSMISSION ) || NUM_SPOT_LIGHT_COORDS > 0

	vec4 worldPosition = vec4( transformed, 1.0 );

	#ifdef USE_BATCHING

		worldPosition = batchingMatrix * worldPosition;

	#endif

	#ifdef USE_INSTANCING

		worldPosition = instanceMatrix * worldPosition;

	#endif

	worldPosition = modelMatrix * worldPosition;

#endif
`;var ep=`
varying vec2 vUv;
uniform mat3 uvTransform;

void main() {

	vUv = ( uvTransform * vec3( uv, 1 ) ).xy;

	gl_Position = vec4( position.xy, 1.0, 1.0 );

}
`,tp=`
uniform sampler2D t2D;
uniform float backgroundIntensity;

varying vec2 vUv;

void main() {

	vec4 texColor = texture2D( t2D, vUv );

	#ifdef DECODE_VIDEO_TEXTURE

		// use inline sRGB decode until browsers properly support SRGB8_ALPHA8 with video textures

		texColor = vec4( mix( pow( texColor.rgb * 0.9478672986 + vec3( 0.0521327014 ), vec3( 2.4 ) ), texColor.rgb * 0.0773993808, vec3( lessThanEqual( texColor.rgb, vec3( 0.04045 ) ) ) ), texColor.w );

	#endif

	texColor.rgb *= backgroundIntensity;

	gl_FragColor = texColor;

	#include <tonemapping_fragment>
	#include <colorspace_fragment>

}
`;var ip=`
varying vec3 vWorldDirection;

#include <common>

void main() {

	vWorldDirection = transformDirection( position, modelMatrix );

	#include <begin_vertex>
	#include <project_vertex>

	gl_Position.z = gl_Position.w; // set z to camera.far

}
`,np=`

uniform float backgroundBlurriness;
uniform float backgroundIntensity;
uniform mat3 backgroundRotation;

varying vec3 vWorldDirection;

#include <envmap_common_pars_fragment>

void main() {

	#ifdef ENVMAP_TYPE_PMREM

		vec4 texColor = textureLod( envMap, backgroundRotation * vWorldDirection, roughnessToMip( backgroundBlurriness ) );

	#else

		vec4 texColor = textureCube( envMap, backgroundRotation * vWorldDirection );

	#endif

	texColor.rgb *= backgroundIntensity;

	gl_FragColor = texColor;

	#include <tonemapping_fragment>
	#include <colorspace_fragment>

}
`;var rp=`
varying vec3 vWorldDirection;

#include <common>

void main() {

	vWorldDirection = transformDirection( position, modelMatrix );

	#include <begin_vertex>
	#include <project_vertex>

	gl_Position.z = gl_Position.w; // set z to camera.far

}
`,sp=`
uniform samplerCube tCube;
uniform float tFlip;
uniform float opacity;

varying vec3 vWorldDirection;

void main() {

	vec4 texColor = textureCube( tCube, vec3( tFlip * vWorldDirection.x, vWorldDirection.yz ) );

	gl_FragColor = texColor;
	gl_FragColor.a *= opacity;

	#include <tonemapping_fragment>
	#include <colorspace_fragment>

}
`;var op=`
varying vec3 vWorldDirection;

#include <common>

void main() {

	vWorldDirection = transformDirection( position, modelMatrix );

	#include <begin_vertex>
	#include <project_vertex>

}
`,ap=`
uniform sampler2D tEquirect;

varying vec3 vWorldDirection;

#include <common>

void main() {

	vec3 direction = normalize( vWorldDirection );

	vec2 sampleUV = equirectUv( direction );

	gl_FragColor = texture2D( tEquirect, sampleUV );

	#include <tonemapping_fragment>
	#include <colorspace_fragment>

}
`;var lp=`
uniform float scale;
attribute float lineDistance;

varying float vLineDistance;

#include <common>
#include <uv_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <morphtarget_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>

void main() {

	vLineDistance = scale * lineDistance;

	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <fog_vertex>

}
`,cp=`
uniform vec3 diffuse;
uniform float opacity;

uniform float dashSize;
uniform float totalSize;

varying float vLineDistance;

#include <common>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <fog_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>

void main() {

	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>

	if ( mod( vLineDistance, totalSize ) > dashSize ) {

		discard;

	}

	vec3 outgoingLight = vec3( 0.0 );

	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>

	outgoingLight = diffuseColor.rgb; // simple shader

	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>

}
`;var up=`
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <envmap_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>

void main() {

	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <batching_vertex>

	#if defined ( USE_ENVMAP ) || defined ( USE_SKINNING )

		#include <beginnormal_vertex>
		#include <morphnormal_vertex>
		#include <skinbase_vertex>
		#include <skinnormal_vertex>
		#include <defaultnormal_vertex>

	#endif

	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>

	#include <worldpos_vertex>
	#include <envmap_vertex>
	#include <fog_vertex>

}
`,fp=`
uniform vec3 diffuse;
uniform float opacity;

#ifndef FLAT_SHADED

	varying vec3 vNormal;

#endif

#include <common>
#include <dithering_pars_fragment>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <aomap_pars_fragment>
#include <lightmap_pars_fragment>
#include <envmap_common_pars_fragment>
#include <envmap_pars_fragment>
#include <fog_pars_fragment>
#include <specularmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>

void main() {

	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>

	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <specularmap_fragment>

	ReflectedLight reflectedLight = ReflectedLight( vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ) );

	// accumulation (baked indirect lighting only)
	#ifdef USE_LIGHTMAP

		vec4 lightMapTexel = texture2D( lightMap, vLightMapUv );
		reflectedLight.indirectDiffuse += lightMapTexel.rgb * lightMapIntensity * RECIPROCAL_PI;

	#else

		reflectedLight.indirectDiffuse += vec3( 1.0 );

	#endif

	// modulation
	#include <aomap_fragment>

	reflectedLight.indirectDiffuse *= diffuseColor.rgb;

	vec3 outgoingLight = reflectedLight.indirectDiffuse;

	#include <envmap_fragment>

	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
	#include <dithering_fragment>

}
`;var hp=`
uniform float size;
uniform float scale;

#include <common>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <morphtarget_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>

#ifdef USE_POINTS_UV

	varying vec2 vUv;
	uniform mat3 uvTransform;

#endif

void main() {

	#ifdef USE_POINTS_UV

		vUv = ( uvTransform * vec3( uv, 1 ) ).xy;

	#endif

	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <project_vertex>

	gl_PointSize = size;

	#ifdef USE_SIZEATTENUATION

		bool isPerspective = isPerspectiveMatrix( projectionMatrix );

		if ( isPerspective ) gl_PointSize *= ( scale / - mvPosition.z );

	#endif

	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <worldpos_vertex>
	#include <fog_vertex>

}
`,dp=`
uniform vec3 diffuse;
uniform float opacity;

#include <common>
#include <color_pars_fragment>
#include <map_particle_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <fog_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>

void main() {

	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>

	vec3 outgoingLight = vec3( 0.0 );

	#include <logdepthbuf_fragment>
	#include <map_particle_fragment>
	#include <color_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>

	outgoingLight = diffuseColor.rgb;

	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>

}
`;var pp=`
uniform float rotation;
uniform vec2 center;

#include <common>
#include <uv_pars_vertex>
#include <fog_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>

void main() {

	#include <uv_vertex>

	vec4 mvPosition = modelViewMatrix[ 3 ];

	vec2 scale = vec2( length( modelMatrix[ 0 ].xyz ), length( modelMatrix[ 1 ].xyz ) );

	#ifndef USE_SIZEATTENUATION

		bool isPerspective = isPerspectiveMatrix( projectionMatrix );

		if ( isPerspective ) scale *= - mvPosition.z;

	#endif

	vec2 alignedPosition = ( position.xy - ( center - vec2( 0.5 ) ) ) * scale;

	vec2 rotatedPosition;
	rotatedPosition.x = cos( rotation ) * alignedPosition.x - sin( rotation ) * alignedPosition.y;
	rotatedPosition.y = sin( rotation ) * alignedPosition.x + cos( rotation ) * alignedPosition.y;

	mvPosition.xy += rotatedPosition;

	gl_Position = projectionMatrix * mvPosition;

	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <fog_vertex>

}
`,mp=`
uniform vec3 diffuse;
uniform float opacity;

#include <common>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <fog_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>

void main() {

	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>

	vec3 outgoingLight = vec3( 0.0 );

	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>

	outgoingLight = diffuseColor.rgb;

	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>

}
`;var it={alphahash_fragment:th,alphahash_pars_fragment:ih,alphamap_fragment:nh,alphamap_pars_fragment:rh,alphatest_fragment:sh,alphatest_pars_fragment:oh,aomap_fragment:ah,aomap_pars_fragment:lh,batching_pars_vertex:ch,batching_vertex:uh,begin_vertex:fh,beginnormal_vertex:hh,bsdfs:dh,iridescence_fragment:ph,bumpmap_pars_fragment:mh,clipping_planes_fragment:gh,clipping_planes_pars_fragment:_h,clipping_planes_pars_vertex:xh,clipping_planes_vertex:Mh,color_fragment:yh,color_pars_fragment:vh,color_pars_vertex:Sh,color_vertex:Eh,common:bh,defaultnormal_vertex:Th,displacementmap_pars_vertex:Ah,displacementmap_vertex:Rh,emissivemap_fragment:wh,emissivemap_pars_fragment:Ch,colorspace_fragment:Ph,colorspace_pars_fragment:Fh,envmap_fragment:Dh,envmap_common_pars_fragment:Lh,envmap_pars_fragment:Uh,envmap_pars_vertex:Ih,envmap_physical_pars_fragment:qh,envmap_vertex:Oh,fog_vertex:Nh,fog_pars_vertex:Bh,fog_fragment:Gh,fog_pars_fragment:zh,gradientmap_pars_fragment:kh,lightmap_pars_fragment:Hh,lights_lambert_fragment:Vh,lights_lambert_pars_fragment:Wh,lights_pars_begin:Xh,lights_toon_fragment:Yh,lights_toon_pars_fragment:$h,lights_phong_fragment:Kh,lights_phong_pars_fragment:Zh,lights_physical_fragment:Jh,lights_physical_pars_fragment:jh,lights_fragment_begin:Qh,lights_fragment_maps:ed,lights_fragment_end:td,lightprobes_pars_fragment:id,logdepthbuf_fragment:nd,logdepthbuf_pars_fragment:rd,logdepthbuf_pars_vertex:sd,logdepthbuf_vertex:od,map_fragment:ad,map_pars_fragment:ld,map_particle_fragment:cd,map_particle_pars_fragment:ud,metalnessmap_fragment:fd,metalnessmap_pars_fragment:hd,morphinstance_vertex:dd,morphcolor_vertex:pd,morphnormal_vertex:md,morphtarget_pars_vertex:gd,morphtarget_vertex:_d,normal_fragment_begin:xd,normal_fragment_maps:Md,normal_pars_fragment:yd,normal_pars_vertex:vd,normal_vertex:Sd,normalmap_pars_fragment:Ed,clearcoat_normal_fragment_begin:bd,clearcoat_normal_fragment_maps:Td,clearcoat_pars_fragment:Ad,iridescence_pars_fragment:Rd,opaque_fragment:wd,packing:Cd,premultiplied_alpha_fragment:Pd,project_vertex:Fd,dithering_fragment:Dd,dithering_pars_fragment:Ld,roughnessmap_fragment:Ud,roughnessmap_pars_fragment:Id,shadowmap_pars_fragment:Od,shadowmap_pars_vertex:Nd,shadowmap_vertex:Bd,shadowmask_pars_fragment:Gd,skinbase_vertex:zd,skinning_pars_vertex:kd,skinning_vertex:Hd,skinnormal_vertex:Vd,specularmap_fragment:Wd,specularmap_pars_fragment:Xd,tonemapping_fragment:qd,tonemapping_pars_fragment:Yd,transmission_fragment:$d,transmission_pars_fragment:Kd,uv_pars_fragment:Zd,uv_pars_vertex:Jd,uv_vertex:jd,worldpos_vertex:Qd,background_vert:ep,background_frag:tp,backgroundCube_vert:ip,backgroundCube_frag:np,cube_vert:rp,cube_frag:sp,depth_vert:"",depth_frag:"",distance_vert:"",distance_frag:"",equirect_vert:op,equirect_frag:ap,linedashed_vert:lp,linedashed_frag:cp,meshbasic_vert:up,meshbasic_frag:fp,meshlambert_vert:"",meshlambert_frag:"",meshmatcap_vert:"",meshmatcap_frag:"",meshnormal_vert:"",meshnormal_frag:"",meshphong_vert:"",meshphong_frag:"",meshphysical_vert:"",meshphysical_frag:"",meshtoon_vert:"",meshtoon_frag:"",points_vert:hp,points_frag:dp,shadow_vert:"",shadow_frag:"",sprite_vert:pp,sprite_frag:mp};var Ae={common:{diffuse:{value:new $e(16777215)},opacity:{value:1},map:{value:null},mapTransform:{value:new ke},alphaMap:{value:null},alphaMapTransform:{value:new ke},alphaTest:{value:0}},specularmap:{specularMap:{value:null},specularMapTransform:{value:new ke}},envmap:{envMap:{value:null},envMapRotation:{value:new ke},reflectivity:{value:1},ior:{value:1.5},refractionRatio:{value:.98},dfgLUT:{value:null}},aomap:{aoMap:{value:null},aoMapIntensity:{value:1},aoMapTransform:{value:new ke}},lightmap:{lightMap:{value:null},lightMapIntensity:{value:1},lightMapTransform:{value:new ke}},bumpmap:{bumpMap:{value:null},bumpMapTransform:{value:new ke},bumpScale:{value:1}},normalmap:{normalMap:{value:null},normalMapTransform:{value:new ke},normalScale:{value:new Oe(1,1)}},displacementmap:{displacementMap:{value:null},displacementMapTransform:{value:new ke},displacementScale:{value:1},displacementBias:{value:0}},emissivemap:{emissiveMap:{value:null},emissiveMapTransform:{value:new ke}},metalnessmap:{metalnessMap:{value:null},metalnessMapTransform:{value:new ke}},roughnessmap:{roughnessMap:{value:null},roughnessMapTransform:{value:new ke}},gradientmap:{gradientMap:{value:null}},fog:{fogDensity:{value:25e-5},fogNear:{value:1},fogFar:{value:2e3},fogColor:{value:new $e(16777215)}},lights:{ambientLightColor:{value:[]},lightProbe:{value:[]},sunLights:{value:[],properties:{direction:{},color:{}}},sunLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{}}},sunShadowMatrix:{value:[]},sunShadowCascade:{value:[]},directionalLights:{value:[],properties:{direction:{},color:{}}},directionalLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{}}},directionalShadowMatrix:{value:[]},spotLights:{value:[],properties:{color:{},position:{},direction:{},distance:{},coneCos:{},penumbraCos:{},decay:{}}},spotLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{}}},spotLightMap:{value:[]},spotLightMatrix:{value:[]},pointLights:{value:[],properties:{color:{},position:{},decay:{},distance:{}}},pointLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{},shadowCameraNear:{},shadowCameraFar:{}}},pointShadowMatrix:{value:[]},hemisphereLights:{value:[],properties:{direction:{},skyColor:{},groundColor:{}}},rectAreaLights:{value:[],properties:{color:{},position:{},width:{},height:{}}},ltc_1:{value:null},ltc_2:{value:null},probesSH:{value:[]},probesMin:{value:[]},probesMax:{value:[]},probesResolution:{value:[]}},points:{diffuse:{value:new $e(16777215)},opacity:{value:1},size:{value:1},scale:{value:1},map:{value:null},alphaMap:{value:null},alphaMapTransform:{value:new ke},alphaTest:{value:0},uvTransform:{value:new ke}},sprite:{diffuse:{value:new $e(16777215)},opacity:{value:1},center:{value:new Oe(.5,.5)},rotation:{value:0},map:{value:null},mapTransform:{value:new ke},alphaMap:{value:null},alphaMapTransform:{value:new ke},alphaTest:{value:0}}};var nn={basic:{uniforms:Ei([Ae.common,Ae.specularmap,Ae.envmap,Ae.aomap,Ae.lightmap,Ae.fog]),vertexShader:it.meshbasic_vert,fragmentShader:it.meshbasic_frag},lambert:{uniforms:Ei([Ae.common,Ae.specularmap,Ae.envmap,Ae.aomap,Ae.lightmap,Ae.emissivemap,Ae.bumpmap,Ae.normalmap,Ae.displacementmap,Ae.fog,Ae.lights,{emissive:{value:new $e(0)},envMapIntensity:{value:1}}]),vertexShader:it.meshlambert_vert,fragmentShader:it.meshlambert_frag},phong:{uniforms:Ei([Ae.common,Ae.specularmap,Ae.envmap,Ae.aomap,Ae.lightmap,Ae.emissivemap,Ae.bumpmap,Ae.normalmap,Ae.displacementmap,Ae.fog,Ae.lights,{emissive:{value:new $e(0)},specular:{value:new $e(1118481)},shininess:{value:30},envMapIntensity:{value:1}}]),vertexShader:it.meshphong_vert,fragmentShader:it.meshphong_frag},standard:{uniforms:Ei([Ae.common,Ae.envmap,Ae.aomap,Ae.lightmap,Ae.emissivemap,Ae.bumpmap,Ae.normalmap,Ae.displacementmap,Ae.roughnessmap,Ae.metalnessmap,Ae.fog,Ae.lights,{emissive:{value:new $e(0)},roughness:{value:1},metalness:{value:0},envMapIntensity:{value:1}}]),vertexShader:it.meshphysical_vert,fragmentShader:it.meshphysical_frag},toon:{uniforms:Ei([Ae.common,Ae.aomap,Ae.lightmap,Ae.emissivemap,Ae.bumpmap,Ae.normalmap,Ae.displacementmap,Ae.gradientmap,Ae.fog,Ae.lights,{emissive:{value:new $e(0)}}]),vertexShader:it.meshtoon_vert,fragmentShader:it.meshtoon_frag},matcap:{uniforms:Ei([Ae.common,Ae.bumpmap,Ae.normalmap,Ae.displacementmap,Ae.fog,{matcap:{value:null}}]),vertexShader:it.meshmatcap_vert,fragmentShader:it.meshmatcap_frag},points:{uniforms:Ei([Ae.points,Ae.fog]),vertexShader:it.points_vert,fragmentShader:it.points_frag},dashed:{uniforms:Ei([Ae.common,Ae.fog,{scale:{value:1},dashSize:{value:1},totalSize:{value:2}}]),vertexShader:it.linedashed_vert,fragmentShader:it.linedashed_frag},depth:{uniforms:Ei([Ae.common,Ae.displacementmap]),vertexShader:it.depth_vert,fragmentShader:it.depth_frag},normal:{uniforms:Ei([Ae.common,Ae.bumpmap,Ae.normalmap,Ae.displacementmap,{opacity:{value:1}}]),vertexShader:it.meshnormal_vert,fragmentShader:it.meshnormal_frag},sprite:{uniforms:Ei([Ae.sprite,Ae.fog]),vertexShader:it.sprite_vert,fragmentShader:it.sprite_frag},background:{uniforms:{uvTransform:{value:new ke},t2D:{value:null},backgroundIntensity:{value:1}},vertexShader:it.background_vert,fragmentShader:it.background_frag},backgroundCube:{uniforms:{envMap:{value:null},backgroundBlurriness:{value:0},backgroundIntensity:{value:1},backgroundRotation:{value:new ke}},vertexShader:it.backgroundCube_vert,fragmentShader:it.backgroundCube_frag},cube:{uniforms:{tCube:{value:null},tFlip:{value:-1},opacity:{value:1}},vertexShader:it.cube_vert,fragmentShader:it.cube_frag},equirect:{uniforms:{tEquirect:{value:null}},vertexShader:it.equirect_vert,fragmentShader:it.equirect_frag},distance:{uniforms:Ei([Ae.common,Ae.displacementmap,{referencePosition:{value:new I},nearDistance:{value:1},farDistance:{value:1e3}}]),vertexShader:it.distance_vert,fragmentShader:it.distance_frag},shadow:{uniforms:Ei([Ae.lights,Ae.fog,{color:{value:new $e(0)},opacity:{value:1}}]),vertexShader:it.shadow_vert,fragmentShader:it.shadow_frag}};nn.physical={uniforms:Ei([nn.standard.uniforms,{clearcoat:{value:0},clearcoatMap:{value:null},clearcoatMapTransform:{value:new ke},clearcoatNormalMap:{value:null},clearcoatNormalMapTransform:{value:new ke},clearcoatNormalScale:{value:new Oe(1,1)},clearcoatRoughness:{value:0},clearcoatRoughnessMap:{value:null},clearcoatRoughnessMapTransform:{value:new ke},diffuseRoughness:{value:0},diffuseRoughnessMap:{value:null},diffuseRoughnessMapTransform:{value:new ke},dispersion:{value:0},retroreflectivity:{value:0},iridescence:{value:0},iridescenceMap:{value:null},iridescenceMapTransform:{value:new ke},iridescenceIOR:{value:1.3},iridescenceThicknessMinimum:{value:100},iridescenceThicknessMaximum:{value:400},iridescenceThicknessMap:{value:null},iridescenceThicknessMapTransform:{value:new ke},sheen:{value:0},sheenColor:{value:new $e(0)},sheenColorMap:{value:null},sheenColorMapTransform:{value:new ke},sheenRoughness:{value:1},sheenRoughnessMap:{value:null},sheenRoughnessMapTransform:{value:new ke},transmission:{value:0},transmissionMap:{value:null},transmissionMapTransform:{value:new ke},transmissionSamplerSize:{value:new Oe},transmissionSamplerMap:{value:null},thickness:{value:0},thicknessMap:{value:null},thicknessMapTransform:{value:new ke},attenuationDistance:{value:0},attenuationColor:{value:new $e(0)},specularColor:{value:new $e(1,1,1)},specularColorMap:{value:null},specularColorMapTransform:{value:new ke},specularIntensity:{value:1},specularIntensityMap:{value:null},specularIntensityMapTransform:{value:new ke},anisotropyVector:{value:new Oe},anisotropyMap:{value:null},anisotropyMapTransform:{value:new ke}}]),vertexShader:it.meshphysical_vert,fragmentShader:it.meshphysical_frag};var pl={r:0,b:0,g:0},Vx=new tt,gp=new ke;gp.set(-1,0,0,0,1,0,0,0,1);function _p(i,e,t,n,r,s){let o=new $e(0),a=r===!0?0:1,l,c,u=null,h=0,d=null;function g(b){let w=b.isScene===!0?b.background:null;if(w&&w.isTexture){let R=b.backgroundBlurriness>0;w=e.get(w,R)}return w}function M(b){let w=!1,R=g(b);R===null?_(o,a):R&&R.isColor&&(_(R,1),w=!0);let P=i.xr.getEnvironmentBlendMode();P==="additive"?t.buffers.color.setClear(0,0,0,1,s):P==="alpha-blend"&&t.buffers.color.setClear(0,0,0,0,s),(i.autoClear||w)&&(t.buffers.depth.setTest(!0),t.buffers.depth.setMask(!0),t.buffers.color.setMask(!0),i.clear(i.autoClearColor,i.autoClearDepth,i.autoClearStencil))}function S(b,w){let R=g(w);R&&R.isCubeTexture?(c===void 0&&(c=new oi(new sr(1,1,1),new ai({name:"BackgroundCubeMaterial",uniforms:Vn(nn.backgroundCube.uniforms),vertexShader:nn.backgroundCube.vertexShader,fragmentShader:nn.backgroundCube.fragmentShader,side:Ot,depthTest:!1,depthWrite:!1,fog:!1,allowOverride:!1})),c.geometry.deleteAttribute("normal"),c.geometry.deleteAttribute("uv"),c.onBeforeRender=function(P,C,x){this.matrixWorld.copyPosition(x.matrixWorld)},Object.defineProperty(c.material,"envMap",{get:function(){return this.uniforms.envMap.value}}),n.update(c)),c.material.uniforms.envMap.value=R,c.material.uniforms.backgroundBlurriness.value=w.backgroundBlurriness,c.material.uniforms.backgroundIntensity.value=w.backgroundIntensity,c.material.uniforms.backgroundRotation.value.setFromMatrix4(Vx.makeRotationFromEuler(w.backgroundRotation)).transpose(),R.isRenderTargetTexture===!1&&c.material.uniforms.backgroundRotation.value.premultiply(gp),c.material.toneMapped=je.getTransfer(R.colorSpace)!==lt,(u!==R||h!==R.version||d!==i.toneMapping)&&(c.material.needsUpdate=!0,u=R,h=R.version,d=i.toneMapping),c.layers.enableAll(),b.unshift(c,c.geometry,c.material,0,0,null)):R&&R.isTexture&&(l===void 0&&(l=new oi(new Ms(2,2),new ai({name:"BackgroundMaterial",uniforms:Vn(nn.background.uniforms),vertexShader:nn.background.vertexShader,fragmentShader:nn.background.fragmentShader,side:Ji,depthTest:!1,depthWrite:!1,fog:!1,allowOverride:!1})),l.geometry.deleteAttribute("normal"),Object.defineProperty(l.material,"map",{get:function(){return this.uniforms.t2D.value}}),n.update(l)),l.material.uniforms.t2D.value=R,l.material.uniforms.backgroundIntensity.value=w.backgroundIntensity,l.material.toneMapped=je.getTransfer(R.colorSpace)!==lt,R.matrixAutoUpdate===!0&&R.updateMatrix(),l.material.uniforms.uvTransform.value.copy(R.matrix),(u!==R||h!==R.version||d!==i.toneMapping)&&(l.material.needsUpdate=!0,u=R,h=R.version,d=i.toneMapping),l.layers.enableAll(),b.unshift(l,l.geometry,l.material,0,0,null))}function _(b,w){b.getRGB(pl,nl(i)),t.buffers.color.setClear(pl.r,pl.g,pl.b,w,s)}function m(){c!==void 0&&(c.geometry.dispose(),c.material.dispose(),c=void 0),l!==void 0&&(l.geometry.dispose(),l.material.dispose(),l=void 0)}return{getClearColor:function(){return o},setClearColor:function(b,w=1){o.set(b),a=w,_(o,a)},getClearAlpha:function(){return a},setClearAlpha:function(b){a=b,_(o,a)},render:M,addToRenderList:S,dispose:m}}function xp(i,e){let t=i.getParameter(i.MAX_VERTEX_ATTRIBS),n={},r=d(null),s=r,o=!1;function a(G,W,ee,U,$){let ne=!1,O=h(G,U,ee,W);s!==O&&(s=O,c(s.object)),ne=g(G,U,ee,$),ne&&M(G,U,ee,$),$!==null&&e.update($,i.ELEMENT_ARRAY_BUFFER),(ne||o)&&(o=!1,R(G,W,ee,U),$!==null&&i.bindBuffer(i.ELEMENT_ARRAY_BUFFER,e.get($).buffer))}function l(){return i.createVertexArray()}function c(G){return i.bindVertexArray(G)}function u(G){return i.deleteVertexArray(G)}function h(G,W,ee,U){let $=U.wireframe===!0,ne=n[W.id];ne===void 0&&(ne={},n[W.id]=ne);let O=G.isInstancedMesh===!0?G.id:0,ue=ne[O];ue===void 0&&(ue={},ne[O]=ue);let K=ue[ee.id];K===void 0&&(K={},ue[ee.id]=K);let re=K[$];return re===void 0&&(re=d(l()),K[$]=re),re}function d(G){let W=[],ee=[],U=[];for(let $=0;$<t;$++)W[$]=0,ee[$]=0,U[$]=0;return{geometry:null,program:null,wireframe:!1,newAttributes:W,enabledAttributes:ee,attributeDivisors:U,object:G,attributes:{},index:null}}function g(G,W,ee,U){let $=s.attributes,ne=W.attributes,O=0,ue=ee.getAttributes();for(let K in ue)if(ue[K].location>=0){let le=$[K],Ue=ne[K];if(Ue===void 0&&(K==="instanceMatrix"&&G.instanceMatrix&&(Ue=G.instanceMatrix),K==="instanceColor"&&G.instanceColor&&(Ue=G.instanceColor)),le===void 0||le.attribute!==Ue||Ue&&le.data!==Ue.data)return!0;O++}return s.attributesNum!==O||s.index!==U}function M(G,W,ee,U){let $={},ne=W.attributes,O=0,ue=ee.getAttributes();for(let K in ue)if(ue[K].location>=0){let le=ne[K];le===void 0&&(K==="instanceMatrix"&&G.instanceMatrix&&(le=G.instanceMatrix),K==="instanceColor"&&G.instanceColor&&(le=G.instanceColor));let Ue={};Ue.attribute=le,le&&le.data&&(Ue.data=le.data),$[K]=Ue,O++}s.attributes=$,s.attributesNum=O,s.index=U}function S(){let G=s.newAttributes;for(let W=0,ee=G.length;W<ee;W++)G[W]=0}function _(G){m(G,0)}function m(G,W){let ee=s.newAttributes,U=s.enabledAttributes,$=s.attributeDivisors;ee[G]=1,U[G]===0&&(i.enableVertexAttribArray(G),U[G]=1),$[G]!==W&&(i.vertexAttribDivisor(G,W),$[G]=W)}function b(){let G=s.newAttributes,W=s.enabledAttributes;for(let ee=0,U=W.length;ee<U;ee++)W[ee]!==G[ee]&&(i.disableVertexAttribArray(ee),W[ee]=0)}function w(G,W,ee,U,$,ne,O){O===!0?i.vertexAttribIPointer(G,W,ee,$,ne):i.vertexAttribPointer(G,W,ee,U,$,ne)}function R(G,W,ee,U){S();let $=U.attributes,ne=ee.getAttributes(),O=W.defaultAttributeValues;for(let ue in ne){let K=ne[ue];if(K.location>=0){let re=$[ue];if(re===void 0&&(ue==="instanceMatrix"&&G.instanceMatrix&&(re=G.instanceMatrix),ue==="instanceColor"&&G.instanceColor&&(re=G.instanceColor)),re!==void 0){let le=re.normalized,Ue=re.itemSize,Ze=e.get(re);if(Ze===void 0)continue;let Q=Ze.buffer,_e=Ze.type,Ee=Ze.bytesPerElement,Ge=_e===i.INT||_e===i.UNSIGNED_INT||re.gpuType===Vr;if(re.isInterleavedBufferAttribute){let be=re.data,Fe=be.isInterleavedBuffer===!0?be.stride:be.itemSize,Ye=re.offset;if(be.isInstancedInterleavedBuffer||be.isInstancedBufferAttribute){for(let Ve=0;Ve<K.locationSize;Ve++)m(K.location+Ve,be.meshPerAttribute);G.isInstancedMesh!==!0&&U._maxInstanceCount===void 0&&(U._maxInstanceCount=be.meshPerAttribute*be.count)}else for(let Ve=0;Ve<K.locationSize;Ve++)_(K.location+Ve);i.bindBuffer(i.ARRAY_BUFFER,Q);for(let Ve=0;Ve<K.locationSize;Ve++)w(K.location+Ve,Ue/K.locationSize,_e,le,Fe*Ee,(Ye+Ue/K.locationSize*Ve)*Ee,Ge)}else{if(re.isInstancedBufferAttribute){for(let be=0;be<K.locationSize;be++)m(K.location+be,re.meshPerAttribute);G.isInstancedMesh!==!0&&U._maxInstanceCount===void 0&&(U._maxInstanceCount=re.meshPerAttribute*re.count)}else for(let be=0;be<K.locationSize;be++)_(K.location+be);i.bindBuffer(i.ARRAY_BUFFER,Q);for(let be=0;be<K.locationSize;be++)w(K.location+be,Ue/K.locationSize,_e,le,Ue*Ee,Ue/K.locationSize*be*Ee,Ge)}}else if(O!==void 0){let le=O[ue];if(le!==void 0)switch(le.length){case 2:i.vertexAttrib2fv(K.location,le);break;case 3:i.vertexAttrib3fv(K.location,le);break;case 4:i.vertexAttrib4fv(K.location,le);break;default:i.vertexAttrib1fv(K.location,le)}}}}b()}function P(){V();for(let G in n){let W=n[G];for(let ee in W){let U=W[ee];for(let $ in U){let ne=U[$];for(let O in ne)u(ne[O].object),delete ne[O];delete U[$]}}delete n[G]}}function C(G){if(n[G.id]===void 0)return;let W=n[G.id];for(let ee in W){let U=W[ee];for(let $ in U){let ne=U[$];for(let O in ne)u(ne[O].object),delete ne[O];delete U[$]}}delete n[G.id]}function x(G){for(let W in n){let ee=n[W];for(let U in ee){let $=ee[U];if($[G.id]===void 0)continue;let ne=$[G.id];for(let O in ne)u(ne[O].object),delete ne[O];delete $[G.id]}}}function A(G){for(let W in n){let ee=n[W],U=G.isInstancedMesh===!0?G.id:0,$=ee[U];if($!==void 0){for(let ne in $){let O=$[ne];for(let ue in O)u(O[ue].object),delete O[ue];delete $[ne]}delete ee[U],Object.keys(ee).length===0&&delete n[W]}}}function V(){N(),o=!0,s!==r&&(s=r,c(s.object))}function N(){r.geometry=null,r.program=null,r.wireframe=!1}return{setup:a,reset:V,resetDefaultState:N,dispose:P,releaseStatesOfGeometry:C,releaseStatesOfObject:A,releaseStatesOfProgram:x,initAttributes:S,enableAttribute:_,disableUnusedAttributes:b}}function Mp(i,e,t){let n;function r(l){n=l}function s(l,c){i.drawArrays(n,l,c),t.update(c,n,1)}function o(l,c,u){u!==0&&(i.drawArraysInstanced(n,l,c,u),t.update(c,n,u))}function a(l,c,u){if(u===0)return;e.get("WEBGL_multi_draw").multiDrawArraysWEBGL(n,l,0,c,0,u);let d=0;for(let g=0;g<u;g++)d+=c[g];t.update(d,n,1)}this.setMode=r,this.render=s,this.renderInstances=o,this.renderMultiDraw=a}function yp(i,e,t,n){let r;function s(){if(r!==void 0)return r;if(e.has("EXT_texture_filter_anisotropic")===!0){let x=e.get("EXT_texture_filter_anisotropic");r=i.getParameter(x.MAX_TEXTURE_MAX_ANISOTROPY_EXT)}else r=0;return r}function o(x){return!(x!==xi&&n.convert(x)!==i.getParameter(i.IMPLEMENTATION_COLOR_READ_FORMAT))}function a(x){let A=x===ti&&(e.has("EXT_color_buffer_half_float")||e.has("EXT_color_buffer_float"));return!(x!==Kt&&x!==fi&&!A&&n.convert(x)!==i.getParameter(i.IMPLEMENTATION_COLOR_READ_TYPE))}function l(x){if(x==="highp"){if(i.getShaderPrecisionFormat(i.VERTEX_SHADER,i.HIGH_FLOAT).precision>0&&i.getShaderPrecisionFormat(i.FRAGMENT_SHADER,i.HIGH_FLOAT).precision>0)return"highp";x="mediump"}return x==="mediump"&&i.getShaderPrecisionFormat(i.VERTEX_SHADER,i.MEDIUM_FLOAT).precision>0&&i.getShaderPrecisionFormat(i.FRAGMENT_SHADER,i.MEDIUM_FLOAT).precision>0?"mediump":"lowp"}let c=t.precision!==void 0?t.precision:"highp",u=l(c);u!==c&&(Ce("WebGLRenderer:",c,"not supported, using",u,"instead."),c=u);let h=t.reversedDepthBuffer===!0&&e.has("EXT_clip_control"),d=t.logarithmicDepthBuffer===!0&&h===!1;t.reversedDepthBuffer===!0&&h===!1&&Ce("WebGLRenderer: Unable to use reversed depth buffer due to missing EXT_clip_control extension. Fallback to default depth buffer."),t.logarithmicDepthBuffer===!0&&h===!0&&Ce("WebGLRenderer: Logarithmic depth buffer is ignored when reversed depth buffer is enabled.");let g=i.getParameter(i.MAX_TEXTURE_IMAGE_UNITS),M=i.getParameter(i.MAX_VERTEX_TEXTURE_IMAGE_UNITS),S=i.getParameter(i.MAX_TEXTURE_SIZE),_=i.getParameter(i.MAX_CUBE_MAP_TEXTURE_SIZE),m=i.getParameter(i.MAX_VERTEX_ATTRIBS),b=i.getParameter(i.MAX_VERTEX_UNIFORM_VECTORS),w=i.getParameter(i.MAX_VARYING_VECTORS),R=i.getParameter(i.MAX_FRAGMENT_UNIFORM_VECTORS),P=i.getParameter(i.MAX_SAMPLES),C=i.getParameter(i.SAMPLES);return{isWebGL2:!0,getMaxAnisotropy:s,getMaxPrecision:l,textureFormatReadable:o,textureTypeReadable:a,precision:c,logarithmicDepthBuffer:d,reversedDepthBuffer:h,maxTextures:g,maxVertexTextures:M,maxTextureSize:S,maxCubemapSize:_,maxAttributes:m,maxVertexUniforms:b,maxVaryings:w,maxFragmentUniforms:R,maxSamples:P,samples:C}}function vp(i){let e=this,t=null,n=0,r=!1,s=!1,o=new si,a=new ke,l={value:null,needsUpdate:!1};this.uniform=l,this.numPlanes=0,this.numIntersection=0,this.init=function(h,d){let g=h.length!==0||d||n!==0||r;return r=d,n=h.length,g},this.beginShadows=function(){s=!0,u(null)},this.endShadows=function(){s=!1},this.setGlobalState=function(h,d){t=u(h,d,0)},this.setState=function(h,d,g){let M=h.clippingPlanes,S=h.clipIntersection,_=h.clipShadows,m=i.get(h);if(!r||M===null||M.length===0||s&&!_)s?u(null):c();else{let b=s?0:n,w=b*4,R=m.clippingState||null;l.value=R,R=u(M,d,w,g);for(let P=0;P!==w;++P)R[P]=t[P];m.clippingState=R,this.numIntersection=S?this.numPlanes:0,this.numPlanes+=b}};function c(){l.value!==t&&(l.value=t,l.needsUpdate=n>0),e.numPlanes=n,e.numIntersection=0}function u(h,d,g,M){let S=h!==null?h.length:0,_=null;if(S!==0){if(_=l.value,M!==!0||_===null){let m=g+S*4,b=d.matrixWorldInverse;a.getNormalMatrix(b),(_===null||_.length<m)&&(_=new Float32Array(m));for(let w=0,R=g;w!==S;++w,R+=4)o.copy(h[w]).applyMatrix4(b,a),o.normal.toArray(_,R),_[R+3]=o.constant}l.value=_,l.needsUpdate=!0}return e.numPlanes=S,e.numIntersection=0,_}}var ar=class extends di{constructor(e=1,t={}){super(e,e,t),this.isWebGLCubeRenderTarget=!0;let n={width:e,height:e,depth:1},r=[n,n,n,n,n,n];this.texture=new gs(r),this._setTextureOptions(t),this.texture.isRenderTargetTexture=!0}fromEquirectangularTexture(e,t){this.texture.type=t.type,this.texture.colorSpace=t.colorSpace,this.texture.generateMipmaps=t.generateMipmaps,this.texture.minFilter=t.minFilter,this.texture.magFilter=t.magFilter;let n={uniforms:{tEquirect:{value:null}},vertexShader:`

				varying vec3 vWorldDirection;

				vec3 transformDirection( in vec3 dir, in mat4 matrix ) {

					return normalize( ( matrix * vec4( dir, 0.0 ) ).xyz );

				}

				void main() {

					vWorldDirection = transformDirection( position, modelMatrix );

					#include <begin_vertex>
					#include <project_vertex>

				}
			`,fragmentShader:`

				uniform sampler2D tEquirect;

				varying vec3 vWorldDirection;

				#include <common>

				void main() {

					vec3 direction = normalize( vWorldDirection );

					vec2 sampleUV = equirectUv( direction );

					gl_FragColor = texture2D( tEquirect, sampleUV );

				}
			`},r=new sr(5,5,5),s=new ai({name:"CubemapFromEquirect",uniforms:Vn(n.uniforms),vertexShader:n.vertexShader,fragmentShader:n.fragmentShader,side:Ot,blending:yn});s.uniforms.tEquirect.value=t;let o=new oi(r,s),a=t.minFilter;return t.minFilter===ki&&(t.minFilter=Bt),new Ir(1,10,this).update(e,o),t.minFilter=a,o.geometry.dispose(),o.material.dispose(),this}clear(e,t=!0,n=!0,r=!0){let s=e.getRenderTarget();for(let o=0;o<6;o++)e.setRenderTarget(this,o),e.clear(t,n,r);e.setRenderTarget(s)}};var Sp=256,Wx=3,Xx=20,Ap=256,Rp=16,qx=3,Yx=new I,$x=new $e,Lo=class i{constructor(e){this._renderer=e,this._cubeSize=0,this._sourceTarget=null,this._cubeCamera=new Ir(1,10,null),this._boxMesh=new oi(new sr(5,5,5),null),this._cubemapMaterial=null,this._equirectMaterial=null,this._blurMaterial=null,this._ggxMaterial=null,this._integrationMaterial=null}fromScene(e,t=0,n=.1,r=100,s={}){let{size:o=256,position:a=Yx}=s,l=this._renderer;this._setSize(o);let c=this._allocateTarget(),u=this._getSourceTarget(!0);t>0&&(u.texture.mipmapsAutoUpdate=!1);let h=l.autoClear,d=l.autoClearColor,g=l.autoClearDepth,M=l.autoClearStencil,S=e.background;l.autoClear=!0,l.autoClearColor=!0,l.autoClearDepth=!0,l.autoClearStencil=!0,S===null&&(e.background=l.getClearColor($x));let _=new Ir(n,r,u);return _.position.copy(a),_.update(l,e),l.autoClear=h,l.autoClearColor=d,l.autoClearDepth=g,l.autoClearStencil=M,e.background=S,t>0&&(u.texture.mipmapsAutoUpdate=!0,this._blur(c,t)),this._applyPMREM(c),c}fromEquirectangular(e,t=null){return this._fromTexture(e,t)}fromCubemap(e,t=null){return this._fromTexture(e,t)}compileCubemapShader(){this._cubemapMaterial===null&&(this._cubemapMaterial=Tp(),this._compileMaterial(this._cubemapMaterial))}compileEquirectangularShader(){this._equirectMaterial===null&&(this._equirectMaterial=bp(),this._compileMaterial(this._equirectMaterial))}dispose(){this._sourceTarget!==null&&this._sourceTarget.dispose(),this._cubemapMaterial!==null&&this._cubemapMaterial.dispose(),this._equirectMaterial!==null&&this._equirectMaterial.dispose(),this._blurMaterial!==null&&this._blurMaterial.dispose(),this._ggxMaterial!==null&&this._ggxMaterial.dispose(),this._integrationMaterial!==null&&this._integrationMaterial.dispose(),this._boxMesh.geometry.dispose()}static lodToRoughness(e,t){return t>0?1-Math.sqrt(1-e/t):0}_setSize(e){this._cubeSize=Math.max(Sp,hc(e))}_fromTexture(e,t){e.mapping===vn||e.mapping===Zn?this._setSize(e.image.length===0?Sp:e.image[0].width||e.image[0].image.width):this._setSize(e.image.width/4);let n=t||this._allocateTarget();return this._textureToCubemap(e),this._applyPMREM(n),n}_allocateTarget(){let e=this._cubeSize,t=Ep(e,!1,!1),n=Math.log2(e)-Wx;for(let r=0;r<=n;r++)t.texture.mipmaps.push({width:e>>r,height:e>>r});return t.texture.name="PMREM",t.texture.isPMREMTexture=!0,t}_getSourceTarget(e=!1){let t=this._cubeSize,n=this._sourceTarget;return(n===null||n.width!==t||e&&n.depthBuffer===!1)&&(n!==null&&n.dispose(),this._sourceTarget=Ep(t,!0,e)),this._sourceTarget}_compileMaterial(e){this._boxMesh.material=e,this._renderer.compile(this._boxMesh,this._cubeCamera.children[0])}_renderCube(e,t,n){let r=this._boxMesh,s=this._cubeCamera;r.material=n,s.renderTarget=e,s.activeMipmapLevel=t;let o=e.width>>t;e.viewport.set(0,0,o,o),s.update(this._renderer,r),e.viewport.set(0,0,e.width,e.height)}_textureToCubemap(e){let t;e.mapping===vn||e.mapping===Zn?(this._cubemapMaterial===null&&(this._cubemapMaterial=Tp()),t=this._cubemapMaterial,t.uniforms.flipEnvMap.value=e.isRenderTargetTexture===!1?-1:1):(this._equirectMaterial===null&&(this._equirectMaterial=bp()),t=this._equirectMaterial),t.uniforms.envMap.value=e,this._renderCube(this._getSourceTarget(),0,t)}_applyPMREM(e){this._ggxMaterial===null&&(this._ggxMaterial=Kx(),this._integrationMaterial=Zx());let t=this._cubeSize,n=e.texture.mipmaps.length-1,r=this._ggxMaterial.uniforms;r.envMap.value=this._sourceTarget.texture;let s=this._integrationMaterial.uniforms;s.envMap.value=this._sourceTarget.texture,s.sourceLod.value=Math.log2(t/Rp);for(let o=0;o<=n;o++){let a=i.lodToRoughness(o,n);if(o>n-qx)s.roughness.value=a,this._renderCube(e,o,this._integrationMaterial);else{let l=a>0?Math.log2(t)+.5*Math.log2(6/(Ap*Math.pow(a,4)))+.5:0;r.roughness.value=a,r.lodBias.value=l,this._renderCube(e,o,this._ggxMaterial)}}}_blur(e,t){this._blurMaterial===null&&(this._blurMaterial=Jx());let n=this._blurMaterial,r=n.uniforms,s=this._sourceTarget;r.sigma.value=Math.min(t,Math.PI)/Math.SQRT2,r.envMap.value=s.texture,this._renderCube(e,0,n),r.envMap.value=e.texture,this._renderCube(s,0,n)}};function Ep(i,e,t){return new ar(i,{minFilter:ki,generateMipmaps:e,type:ti,colorSpace:On,depthBuffer:t})}function Uo(i,e,t){return new ai({name:i,uniforms:e,vertexShader:it.cube_vert,fragmentShader:t,side:Ot,blending:yn,depthTest:!1,depthWrite:!1})}function Kx(){return Uo("PMREMGGXConvolution",{envMap:{value:null},roughness:{value:0},lodBias:{value:0}},`

		#define GGX_SAMPLES ${Ap}u

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float roughness;
		uniform float lodBias;

		#include <common>

		// Van der Corput radical inverse
		float radicalInverse_VdC( uint bits ) {

			bits = ( bits << 16u ) | ( bits >> 16u );
			bits = ( ( bits & 0x55555555u ) << 1u ) | ( ( bits & 0xAAAAAAAAu ) >> 1u );
			bits = ( ( bits & 0x33333333u ) << 2u ) | ( ( bits & 0xCCCCCCCCu ) >> 2u );
			bits = ( ( bits & 0x0F0F0F0Fu ) << 4u ) | ( ( bits & 0xF0F0F0F0u ) >> 4u );
			bits = ( ( bits & 0x00FF00FFu ) << 8u ) | ( ( bits & 0xFF00FF00u ) >> 8u );
			return float( bits ) * 2.3283064365386963e-10; // / 0x100000000

		}

		// Hammersley sequence
		vec2 hammersley( uint i, uint N ) {

			return vec2( float( i ) / float( N ), radicalInverse_VdC( i ) );

		}

		void main() {

			vec3 N = normalize( vWorldDirection );

			// For very low roughness, just sample the environment directly
			if ( roughness < 0.001 ) {

				gl_FragColor = vec4( textureLod( envMap, N, 0.0 ).rgb, 1.0 );
				return;

			}

			float alpha = roughness * roughness;
			float alpha2 = alpha * alpha;

			// Tangent space basis for VNDF sampling
			vec3 up = abs( N.z ) < 0.999 ? vec3( 0.0, 0.0, 1.0 ) : vec3( 1.0, 0.0, 0.0 );
			vec3 tangent = normalize( cross( up, N ) );
			vec3 bitangent = cross( N, tangent );

			vec3 prefilteredColor = vec3( 0.0 );
			float totalWeight = 0.0;

			for ( uint i = 0u; i < GGX_SAMPLES; i ++ ) {

				vec2 Xi = hammersley( i, GGX_SAMPLES );

				// With V = N, sample the reflected direction directly.
				float invQ = 1.0 / ( 1.0 - Xi.x + alpha2 * Xi.x );
				float NdotL = ( 1.0 - Xi.x - alpha2 * Xi.x ) * invQ;

				if ( NdotL > 0.0 ) {

					float phi = 2.0 * PI * Xi.y;
					float sinTheta = 2.0 * alpha * sqrt( Xi.x * ( 1.0 - Xi.x ) ) * invQ;
					vec3 L = N * NdotL + ( tangent * cos( phi ) + bitangent * sin( phi ) ) * sinTheta;

					// Match the source mip to the sample's solid angle. The terms
					// independent of the sample are precomputed in lodBias.
					float d = alpha2 * invQ;
					float lod = max( log2( d ) + lodBias, 0.0 );

					// Weight by NdotL for the split-sum approximation
					prefilteredColor += textureLod( envMap, L, lod ).rgb * NdotL;
					totalWeight += NdotL;

				}

			}

			gl_FragColor = vec4( prefilteredColor / totalWeight, 1.0 );

		}
	`)}function Zx(){return Uo("PMREMGGXIntegration",{envMap:{value:null},roughness:{value:0},sourceLod:{value:0},sourceSize:{value:Rp}},`

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float roughness;
		uniform float sourceLod;
		uniform int sourceSize;

		void main() {

			vec3 N = normalize( vWorldDirection );

			float alpha = roughness * roughness;
			float alpha2 = alpha * alpha;

			float texelSize = 2.0 / float( sourceSize );

			vec3 prefilteredColor = vec3( 0.0 );
			float totalWeight = 0.0;

			// Pair opposite texels: only the one in N's hemisphere contributes.
			for ( int face = 0; face < 3; face ++ ) {

				for ( int y = 0; y < sourceSize; y ++ ) {

					for ( int x = 0; x < sourceSize; x ++ ) {

						vec2 uv = ( vec2( x, y ) + 0.5 ) * texelSize - 1.0;
						vec3 texelDirection = face == 0 ? vec3( 1.0, uv ) : ( face == 1 ? vec3( uv.x, 1.0, uv.y ) : vec3( uv, 1.0 ) );

						float invDistance = inversesqrt( 1.0 + dot( uv, uv ) );
						float NdotL = dot( N, texelDirection );
						texelDirection *= NdotL < 0.0 ? - 1.0 : 1.0;
						NdotL = abs( NdotL ) * invDistance;

						// With V = N, NdotH squared is ( 1 + NdotL ) / 2. Common factors
						// in the GGX distribution and texel solid angle cancel when normalized.
						float d = 1.0 + alpha2 + ( alpha2 - 1.0 ) * NdotL;
						float weight = NdotL * invDistance * invDistance * invDistance / ( d * d );

						prefilteredColor += textureLod( envMap, texelDirection, sourceLod ).rgb * weight;
						totalWeight += weight;

					}

				}

			}

			gl_FragColor = vec4( prefilteredColor / totalWeight, 1.0 );

		}
	`)}function Jx(){return Uo("PMREMSphericalGaussianBlur",{envMap:{value:null},sigma:{value:0}},`

		#define SAMPLES ${Xx}
		#define GOLDEN_ANGLE 2.39996322973

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float sigma;

		#include <common>

		void main() {

			vec3 outputDirection = normalize( vWorldDirection );

			vec3 up = abs( outputDirection.z ) < 0.999 ? vec3( 0.0, 0.0, 1.0 ) : vec3( 1.0, 0.0, 0.0 );
			vec3 tangent = normalize( cross( up, outputDirection ) );
			vec3 bitangent = cross( outputDirection, tangent );

			// Truncate the kernel at three standard deviations or at the antipode.
			float thetaMax = min( 3.0 * sigma, PI );
			float truncation = 1.0 - exp( - 0.5 * thetaMax * thetaMax / ( sigma * sigma ) );

			vec3 accumColor = vec3( 0.0 );
			float accumWeight = 0.0;

			for ( int i = 0; i < SAMPLES; i ++ ) {

				// Stratified inverse-CDF sampling of the Gaussian, placed on a golden-angle spiral.
				float stratum = ( float( i ) + 0.5 ) / float( SAMPLES );
				float theta = sigma * sqrt( - 2.0 * log( 1.0 - stratum * truncation ) );
				float phi = float( i ) * GOLDEN_ANGLE;

				vec3 offset = cos( phi ) * tangent + sin( phi ) * bitangent;
				vec3 sampleDirection = cos( theta ) * outputDirection + sin( theta ) * offset;

				// Correct the planar sample density to solid angle.
				float weight = sin( theta ) / theta;

				accumColor += weight * textureLod( envMap, sampleDirection, 0.0 ).rgb;
				accumWeight += weight;

			}

			gl_FragColor = vec4( accumColor / accumWeight, 1.0 );

		}
	`)}function bp(){return Uo("PMREMEquirectangularToCubemap",{envMap:{value:null}},`

		varying vec3 vWorldDirection;

		uniform sampler2D envMap;

		#include <common>

		void main() {

			// Average four subpixel samples to preserve small, bright features.
			vec3 direction = normalize( vWorldDirection );
			vec3 dx = dFdx( direction ) * 0.25;
			vec3 dy = dFdy( direction ) * 0.25;

			vec3 color = textureLod( envMap, equirectUv( normalize( direction - dx - dy ) ), 0.0 ).rgb;
			color += textureLod( envMap, equirectUv( normalize( direction + dx - dy ) ), 0.0 ).rgb;
			color += textureLod( envMap, equirectUv( normalize( direction - dx + dy ) ), 0.0 ).rgb;
			color += textureLod( envMap, equirectUv( normalize( direction + dx + dy ) ), 0.0 ).rgb;
			gl_FragColor = vec4( color * 0.25, 1.0 );

		}
	`)}function Tp(){return Uo("PMREMCubemapToCubemap",{envMap:{value:null},flipEnvMap:{value:-1}},`

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float flipEnvMap;

		void main() {

			gl_FragColor = vec4( textureCube( envMap, vec3( flipEnvMap * vWorldDirection.x, vWorldDirection.yz ) ).rgb, 1.0 );

		}
	`)}function wp(i){let e=new WeakMap,t=new WeakMap,n=null;function r(d,g=!1){return d==null?null:g?o(d):s(d)}function s(d){if(d&&d.isTexture){let g=d.mapping;if(g===da||g===pa)if(e.has(d)){let M=e.get(d).texture;return a(M,d.mapping)}else{let M=d.image;if(M&&M.height>0){let S=new ar(M.height);return S.fromEquirectangularTexture(i,d),e.set(d,S),d.addEventListener("dispose",c),a(S.texture,d.mapping)}else return null}}return d}function o(d){if(d&&d.isTexture&&d.isPMREMTexture!==!0){let g=d.mapping,M=g===da||g===pa,S=g===vn||g===Zn;if(M||S){let _=t.get(d),m=_!==void 0?_.texture.pmremVersion:0;if(d.isRenderTargetTexture&&d.pmremVersion!==m)return n===null&&(n=new Lo(i)),_=M?n.fromEquirectangular(d,_):n.fromCubemap(d,_),_.texture.pmremVersion=d.pmremVersion,t.set(d,_),_.texture;if(_!==void 0)return _.texture;{let b=d.image;return M&&b&&b.height>0||S&&b&&l(b)?(n===null&&(n=new Lo(i)),_=M?n.fromEquirectangular(d):n.fromCubemap(d),_.texture.pmremVersion=d.pmremVersion,t.set(d,_),d.addEventListener("dispose",u),_.texture):null}}}return d}function a(d,g){return g===da?d.mapping=vn:g===pa&&(d.mapping=Zn),d}function l(d){let g=0,M=6;for(let S=0;S<M;S++)d[S]!==void 0&&g++;return g===M}function c(d){let g=d.target;g.removeEventListener("dispose",c);let M=e.get(g);M!==void 0&&(e.delete(g),M.dispose())}function u(d){let g=d.target;g.removeEventListener("dispose",u);let M=t.get(g);M!==void 0&&(t.delete(g),M.dispose())}function h(){e=new WeakMap,t=new WeakMap,n!==null&&(n.dispose(),n=null)}return{get:r,dispose:h}}function Cp(i){let e={};function t(n){if(e[n]!==void 0)return e[n];let r=i.getExtension(n);return e[n]=r,r}return{has:function(n){return t(n)!==null},init:function(){t("EXT_color_buffer_float"),t("WEBGL_clip_cull_distance"),t("OES_texture_float_linear"),t("EXT_color_buffer_half_float"),t("WEBGL_multisampled_render_to_texture"),t("WEBGL_render_shared_exponent")},get:function(n){let r=t(n);return r===null&&Sr("WebGLRenderer: "+n+" extension not supported."),r}}}function Pp(i,e,t,n){let r={},s=new WeakMap,o=new FinalizationRegistry(M=>delete r[M]);function a(M){l(M.target)}function l(M){M.index!==null&&e.remove(M.index);for(let _ in M.attributes)e.remove(M.attributes[_]);M.removeEventListener("dispose",a),delete r[M.id],o.unregister(M);let S=s.get(M);S&&(e.remove(S),s.delete(M)),n.releaseStatesOfGeometry(M),M.isInstancedBufferGeometry===!0&&delete M._maxInstanceCount,t.memory.geometries--}function c(M,S){return r[S.id]!==void 0||(S.addEventListener("dispose",a),r[S.id]=new WeakRef(S),o.register(S,S.id,S),t.memory.geometries++),S}function u(M){let S=M.attributes;for(let _ in S)e.update(S[_],i.ARRAY_BUFFER)}function h(M){let S=M.index,_=M.attributes.position,m=0;if(_===void 0)return;let b=S!==null?S.array.length:_.array.length/3-1,w=_.count>=65535?ps:ds,R=new w(Math.ceil(b/3)*6,1),P=R.array;if(S!==null){let x=S.array;m=S.version;for(let A=0,V=0;A<b;A+=3){let N=x[A+0],G=x[A+1],W=x[A+2];P[V++]=N,P[V++]=G,P[V++]=G,P[V++]=W,P[V++]=W,P[V++]=N}}else{m=_.version;for(let x=0,A=0;x<b;x+=3){let V=x+0,N=x+1,G=x+2;P[A++]=V,P[A++]=N,P[A++]=N,P[A++]=G,P[A++]=G,P[A++]=V}}R.version=m;let C=s.get(M);C&&e.remove(C),s.set(M,R)}function d(M){let S=s.get(M);if(S){let _=M.index;_!==null&&S.version<_.version&&h(M)}else h(M);return s.get(M)}function g(){for(let M in r){let S=r[M].deref();S!==void 0&&l(S)}}return{get:c,update:u,getWireframeAttribute:d,dispose:g}}function Fp(i,e,t){let n;function r(h){n=h}let s,o;function a(h){s=h.type,o=h.bytesPerElement}function l(h,d){i.drawElements(n,d,s,h*o),t.update(d,n,1)}function c(h,d,g){g!==0&&(i.drawElementsInstanced(n,d,s,h*o,g),t.update(d,n,g))}function u(h,d,g){if(g===0)return;e.get("WEBGL_multi_draw").multiDrawElementsWEBGL(n,d,0,s,h,0,g);let S=0;for(let _=0;_<g;_++)S+=d[_];t.update(S,n,1)}this.setMode=r,this.setIndex=a,this.render=l,this.renderInstances=c,this.renderMultiDraw=u}function Dp(i){let e={geometries:0,textures:0},t={frame:0,calls:0,triangles:0,points:0,lines:0};function n(s,o,a){switch(t.calls++,o){case i.TRIANGLES:t.triangles+=a*(s/3);break;case i.LINES:t.lines+=a*(s/2);break;case i.LINE_STRIP:t.lines+=a*(s-1);break;case i.LINE_LOOP:t.lines+=a*s;break;case i.POINTS:t.points+=a*s;break;default:ot("WebGLInfo: Unknown draw mode:",o);break}}function r(){t.calls=0,t.triangles=0,t.points=0,t.lines=0}return{memory:e,render:t,programs:null,autoReset:!0,reset:r,update:n}}function Lp(i,e,t){let n=new WeakMap,r=new vt;function s(o,a,l){let c=o.morphTargetInfluences,u=a.morphAttributes.position||a.morphAttributes.normal||a.morphAttributes.color,h=u!==void 0?u.length:0,d=n.get(a);if(d===void 0||d.count!==h){let V=function(){x.dispose(),n.delete(a),a.removeEventListener("dispose",V)};d!==void 0&&d.texture.dispose();let g=a.morphAttributes.position!==void 0,M=a.morphAttributes.normal!==void 0,S=a.morphAttributes.color!==void 0,_=a.morphAttributes.position||[],m=a.morphAttributes.normal||[],b=a.morphAttributes.color||[],w=0;g===!0&&(w=1),M===!0&&(w=2),S===!0&&(w=3);let R=a.attributes.position.count*w,P=1;R>e.maxTextureSize&&(P=Math.ceil(R/e.maxTextureSize),R=e.maxTextureSize);let C=new Float32Array(R*P*4*h),x=new ns(C,R,P,h);x.type=fi,x.needsUpdate=!0;let A=w*4;for(let N=0;N<h;N++){let G=_[N],W=m[N],ee=b[N],U=R*P*4*N;for(let $=0;$<G.count;$++){let ne=$*A;g===!0&&(r.fromBufferAttribute(G,$),C[U+ne+0]=r.x,C[U+ne+1]=r.y,C[U+ne+2]=r.z,C[U+ne+3]=0),M===!0&&(r.fromBufferAttribute(W,$),C[U+ne+4]=r.x,C[U+ne+5]=r.y,C[U+ne+6]=r.z,C[U+ne+7]=0),S===!0&&(r.fromBufferAttribute(ee,$),C[U+ne+8]=r.x,C[U+ne+9]=r.y,C[U+ne+10]=r.z,C[U+ne+11]=ee.itemSize===4?r.w:1)}}d={count:h,texture:x,size:new Oe(R,P)},n.set(a,d),a.addEventListener("dispose",V)}if(o.isInstancedMesh===!0&&o.morphTexture!==null)l.getUniforms().setValue(i,"morphTexture",o.morphTexture,t);else{let g=0;for(let S=0;S<c.length;S++)g+=c[S];let M=a.morphTargetsRelative?1:1-g;l.getUniforms().setValue(i,"morphTargetBaseInfluence",M),l.getUniforms().setValue(i,"morphTargetInfluences",c)}l.getUniforms().setValue(i,"morphTargetsTexture",d.texture,t),l.getUniforms().setValue(i,"morphTargetsTextureSize",d.size)}return{update:s}}function Up(i,e,t,n,r){let s=new WeakMap;function o(c){let u=r.render.frame,h=c.geometry,d=e.get(c,h);if(s.get(d)!==u&&(e.update(d),s.set(d,u)),c.isInstancedMesh&&(c.hasEventListener("dispose",l)===!1&&c.addEventListener("dispose",l),s.get(c)!==u&&(t.update(c.instanceMatrix,i.ARRAY_BUFFER),c.instanceColor!==null&&t.update(c.instanceColor,i.ARRAY_BUFFER),s.set(c,u))),c.isSkinnedMesh){let g=c.skeleton;s.get(g)!==u&&(g.update(),s.set(g,u))}return d}function a(){s=new WeakMap}function l(c){let u=c.target;u.removeEventListener("dispose",l),n.releaseStatesOfObject(u),t.remove(u.instanceMatrix),u.instanceColor!==null&&t.remove(u.instanceColor)}return{update:o,dispose:a}}var jx={[oa]:"LINEAR_TONE_MAPPING",[aa]:"REINHARD_TONE_MAPPING",[la]:"CINEON_TONE_MAPPING",[ca]:"ACES_FILMIC_TONE_MAPPING",[fa]:"AGX_TONE_MAPPING",[ha]:"NEUTRAL_TONE_MAPPING",[ua]:"CUSTOM_TONE_MAPPING"};function Ip(i,e,t,n,r,s){let o=new di(e,t,{type:i,depthBuffer:r,stencilBuffer:s,samples:n?4:0,storeMultisampledDepthBuffer:!1,storeMultisampledStencilBuffer:!1,resolveDepthBuffer:!1,resolveStencilBuffer:!1}),a=null,l=null,c=null,u=new Et;u.setAttribute("position",new Ft([-1,3,0,-1,-1,0,3,-1,0],3)),u.setAttribute("uv",new Ft([0,2,0,0,2,0],2));let h=new rl({uniforms:{tDiffuse:{value:null}},vertexShader:`
			precision highp float;

			uniform mat4 modelViewMatrix;
			uniform mat4 projectionMatrix;

			attribute vec3 position;
			attribute vec2 uv;

			varying vec2 vUv;

			void main() {
				vUv = uv;
				gl_Position = projectionMatrix * modelViewMatrix * vec4( position, 1.0 );
			}`,fragmentShader:`
			precision highp float;

			uniform sampler2D tDiffuse;

			varying vec2 vUv;

			#include <tonemapping_pars_fragment>
			#include <colorspace_pars_fragment>

			void main() {
				gl_FragColor = texture2D( tDiffuse, vUv );

				#ifdef LINEAR_TONE_MAPPING
					gl_FragColor.rgb = LinearToneMapping( gl_FragColor.rgb );
				#elif defined( REINHARD_TONE_MAPPING )
					gl_FragColor.rgb = ReinhardToneMapping( gl_FragColor.rgb );
				#elif defined( CINEON_TONE_MAPPING )
					gl_FragColor.rgb = CineonToneMapping( gl_FragColor.rgb );
				#elif defined( ACES_FILMIC_TONE_MAPPING )
					gl_FragColor.rgb = ACESFilmicToneMapping( gl_FragColor.rgb );
				#elif defined( AGX_TONE_MAPPING )
					gl_FragColor.rgb = AgXToneMapping( gl_FragColor.rgb );
				#elif defined( NEUTRAL_TONE_MAPPING )
					gl_FragColor.rgb = NeutralToneMapping( gl_FragColor.rgb );
				#elif defined( CUSTOM_TONE_MAPPING )
					gl_FragColor.rgb = CustomToneMapping( gl_FragColor.rgb );
				#endif

				#ifdef SRGB_TRANSFER
					gl_FragColor = sRGBTransferOETF( gl_FragColor );
				#endif
			}`,depthTest:!1,depthWrite:!1}),d=new oi(u,h),g=new fl(-1,1,1,-1,0,1),M=null,S=null,_=!1,m,b=null,w=[],R=!1;this.setSize=function(P,C){o.setSize(P,C),a!==null&&a.setSize(P,C),l!==null&&l.setSize(P,C);for(let x=0;x<w.length;x++){let A=w[x];A.setSize&&A.setSize(P,C)}},this.setEffects=function(P){w=P,R=w.length>0&&w[0].isRenderPass===!0;let C=o.width,x=o.height;w.length>0&&a===null&&(a=new di(C,x,{type:ti,depthBuffer:!1,stencilBuffer:!1}),l=new di(C,x,{type:ti,depthBuffer:!1,stencilBuffer:!1}));let A=r===!0&&w.some(V=>V.needsDepthTexture===!0);A!==(o.depthTexture!==null)&&(A===!0&&c===null&&(c=new Ki(C,x),s===!0&&(c.format=Hi,c.type=ln)),o.dispose(),o.depthTexture=A?c:null,o.resolveDepthBuffer=A,o.storeMultisampledDepthBuffer=A);for(let V=0;V<w.length;V++){let N=w[V];N.setSize&&N.setSize(C,x),A&&N.needsDepthTexture===!0&&N.setDepthTexture&&N.setDepthTexture(c)}},this.begin=function(P,C){if(_||P.toneMapping===zi&&w.length===0)return!1;if(b=C,C!==null){let x=C.width,A=C.height;(o.width!==x||o.height!==A)&&this.setSize(x,A)}return R===!1&&P.setRenderTarget(o),m=P.toneMapping,P.toneMapping=zi,!0},this.hasRenderPass=function(){return R},this.end=function(P,C){P.toneMapping=m,_=!0;let x=o,A=a;for(let V=0;V<w.length;V++){let N=w[V];N.enabled!==!1&&(N.render(P,A,x,C),N.needsSwap!==!1&&(x=A,A=A===a?l:a))}if(M!==P.outputColorSpace||S!==P.toneMapping){M=P.outputColorSpace,S=P.toneMapping,h.defines={},je.getTransfer(M)===lt&&(h.defines.SRGB_TRANSFER="");let V=jx[S];V&&(h.defines[V]=""),h.needsUpdate=!0}h.uniforms.tDiffuse.value=x.texture,P.setRenderTarget(b),P.render(d,g),b=null,_=!1},this.isCompositing=function(){return _},this.dispose=function(){o.dispose(),a!==null&&a.dispose(),l!==null&&l.dispose(),u.dispose(),h.dispose()}}var Hp=new Nt,Vp=new Ki(1,1),Wp=new _s(1),Xp=new ns,qp=new Fa,Yp=new gs,Op=[],Np=[],Bp=new Float32Array(16),Gp=new Float32Array(9),zp=new Float32Array(4);function Ts(i,e,t){let n=i[0];if(n<=0||n>0)return i;let r=e*t,s=Op[r];if(s===void 0&&(s=new Float32Array(r),Op[r]=s),e!==0){n.toArray(s,0);for(let o=1,a=0;o!==e;++o)a+=t,i[o].toArray(s,a)}return s}function Zt(i,e){if(i.length!==e.length)return!1;for(let t=0,n=i.length;t<n;t++)if(i[t]!==e[t])return!1;return!0}function Jt(i,e){for(let t=0,n=e.length;t<n;t++)i[t]=e[t]}function ml(i,e){let t=Np[e];t===void 0&&(t=new Int32Array(e),Np[e]=t);for(let n=0;n!==e;++n)t[n]=i.allocateTextureUnit();return t}function Qx(i,e){let t=this.cache;t[0]!==e&&(i.uniform1f(this.addr,e),t[0]=e)}function e0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y)&&(i.uniform2f(this.addr,e.x,e.y),t[0]=e.x,t[1]=e.y);else{if(Zt(t,e))return;i.uniform2fv(this.addr,e),Jt(t,e)}}function t0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y||t[2]!==e.z)&&(i.uniform3f(this.addr,e.x,e.y,e.z),t[0]=e.x,t[1]=e.y,t[2]=e.z);else if(e.r!==void 0)(t[0]!==e.r||t[1]!==e.g||t[2]!==e.b)&&(i.uniform3f(this.addr,e.r,e.g,e.b),t[0]=e.r,t[1]=e.g,t[2]=e.b);else{if(Zt(t,e))return;i.uniform3fv(this.addr,e),Jt(t,e)}}function i0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y||t[2]!==e.z||t[3]!==e.w)&&(i.uniform4f(this.addr,e.x,e.y,e.z,e.w),t[0]=e.x,t[1]=e.y,t[2]=e.z,t[3]=e.w);else{if(Zt(t,e))return;i.uniform4fv(this.addr,e),Jt(t,e)}}function n0(i,e){let t=this.cache,n=e.elements;if(n===void 0){if(Zt(t,e))return;i.uniformMatrix2fv(this.addr,!1,e),Jt(t,e)}else{if(Zt(t,n))return;zp.set(n),i.uniformMatrix2fv(this.addr,!1,zp),Jt(t,n)}}function r0(i,e){let t=this.cache,n=e.elements;if(n===void 0){if(Zt(t,e))return;i.uniformMatrix3fv(this.addr,!1,e),Jt(t,e)}else{if(Zt(t,n))return;Gp.set(n),i.uniformMatrix3fv(this.addr,!1,Gp),Jt(t,n)}}function s0(i,e){let t=this.cache,n=e.elements;if(n===void 0){if(Zt(t,e))return;i.uniformMatrix4fv(this.addr,!1,e),Jt(t,e)}else{if(Zt(t,n))return;Bp.set(n),i.uniformMatrix4fv(this.addr,!1,Bp),Jt(t,n)}}function o0(i,e){let t=this.cache;t[0]!==e&&(i.uniform1i(this.addr,e),t[0]=e)}function a0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y)&&(i.uniform2i(this.addr,e.x,e.y),t[0]=e.x,t[1]=e.y);else{if(Zt(t,e))return;i.uniform2iv(this.addr,e),Jt(t,e)}}function l0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y||t[2]!==e.z)&&(i.uniform3i(this.addr,e.x,e.y,e.z),t[0]=e.x,t[1]=e.y,t[2]=e.z);else{if(Zt(t,e))return;i.uniform3iv(this.addr,e),Jt(t,e)}}function c0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y||t[2]!==e.z||t[3]!==e.w)&&(i.uniform4i(this.addr,e.x,e.y,e.z,e.w),t[0]=e.x,t[1]=e.y,t[2]=e.z,t[3]=e.w);else{if(Zt(t,e))return;i.uniform4iv(this.addr,e),Jt(t,e)}}function u0(i,e){let t=this.cache;t[0]!==e&&(i.uniform1ui(this.addr,e),t[0]=e)}function f0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y)&&(i.uniform2ui(this.addr,e.x,e.y),t[0]=e.x,t[1]=e.y);else{if(Zt(t,e))return;i.uniform2uiv(this.addr,e),Jt(t,e)}}function h0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y||t[2]!==e.z)&&(i.uniform3ui(this.addr,e.x,e.y,e.z),t[0]=e.x,t[1]=e.y,t[2]=e.z);else{if(Zt(t,e))return;i.uniform3uiv(this.addr,e),Jt(t,e)}}function d0(i,e){let t=this.cache;if(e.x!==void 0)(t[0]!==e.x||t[1]!==e.y||t[2]!==e.z||t[3]!==e.w)&&(i.uniform4ui(this.addr,e.x,e.y,e.z,e.w),t[0]=e.x,t[1]=e.y,t[2]=e.z,t[3]=e.w);else{if(Zt(t,e))return;i.uniform4uiv(this.addr,e),Jt(t,e)}}function gl(i){return i.version===0&&(i.compareFunction=Aa,i.needsUpdate=!0),i}function p0(i,e,t){let n=this.cache,r=t.allocateTextureUnit();n[0]!==r&&(i.uniform1i(this.addr,r),n[0]=r);let s;this.type===i.SAMPLER_2D_SHADOW?s=gl(Vp):s=Hp,t.setTexture2D(e||s,r)}function m0(i,e,t){let n=this.cache,r=t.allocateTextureUnit();n[0]!==r&&(i.uniform1i(this.addr,r),n[0]=r),t.setTexture3D(e||qp,r)}function g0(i,e,t){let n=this.cache,r=t.allocateTextureUnit();n[0]!==r&&(i.uniform1i(this.addr,r),n[0]=r);let s;this.type===i.SAMPLER_CUBE_SHADOW?s=gl(Wp):s=Yp,t.setTextureCube(e||s,r)}function _0(i,e,t){let n=this.cache,r=t.allocateTextureUnit();n[0]!==r&&(i.uniform1i(this.addr,r),n[0]=r),t.setTexture2DArray(e||Xp,r)}function x0(i){switch(i){case 5126:return Qx;case 35664:return e0;case 35665:return t0;case 35666:return i0;case 35674:return n0;case 35675:return r0;case 35676:return s0;case 5124:case 35670:return o0;case 35667:case 35671:return a0;case 35668:case 35672:return l0;case 35669:case 35673:return c0;case 5125:return u0;case 36294:return f0;case 36295:return h0;case 36296:return d0;case 35678:case 36198:case 36298:case 36306:case 35682:return p0;case 35679:case 36299:case 36307:return m0;case 35680:case 36300:case 36308:case 36293:return g0;case 36289:case 36303:case 36311:case 36292:return _0}}function M0(i,e){i.uniform1fv(this.addr,e)}function y0(i,e){let t=Ts(e,this.size,2);i.uniform2fv(this.addr,t)}function v0(i,e){let t=Ts(e,this.size,3);i.uniform3fv(this.addr,t)}function S0(i,e){let t=Ts(e,this.size,4);i.uniform4fv(this.addr,t)}function E0(i,e){let t=Ts(e,this.size,4);i.uniformMatrix2fv(this.addr,!1,t)}function b0(i,e){let t=Ts(e,this.size,9);i.uniformMatrix3fv(this.addr,!1,t)}function T0(i,e){let t=Ts(e,this.size,16);i.uniformMatrix4fv(this.addr,!1,t)}function A0(i,e){i.uniform1iv(this.addr,e)}function R0(i,e){i.uniform2iv(this.addr,e)}function w0(i,e){i.uniform3iv(this.addr,e)}function C0(i,e){i.uniform4iv(this.addr,e)}function P0(i,e){i.uniform1uiv(this.addr,e)}function F0(i,e){i.uniform2uiv(this.addr,e)}function D0(i,e){i.uniform3uiv(this.addr,e)}function L0(i,e){i.uniform4uiv(this.addr,e)}function U0(i,e,t){let n=this.cache,r=e.length,s=ml(t,r);Zt(n,s)||(i.uniform1iv(this.addr,s),Jt(n,s));let o;this.type===i.SAMPLER_2D_SHADOW?o=gl(Vp):o=Hp;for(let a=0;a!==r;++a)t.setTexture2D(e[a]||o,s[a])}function I0(i,e,t){let n=this.cache,r=e.length,s=ml(t,r);Zt(n,s)||(i.uniform1iv(this.addr,s),Jt(n,s));for(let o=0;o!==r;++o)t.setTexture3D(e[o]||qp,s[o])}function O0(i,e,t){let n=this.cache,r=e.length,s=ml(t,r);Zt(n,s)||(i.uniform1iv(this.addr,s),Jt(n,s));let o;this.type===i.SAMPLER_CUBE_SHADOW?o=gl(Wp):o=Yp;for(let a=0;a!==r;++a)t.setTextureCube(e[a]||o,s[a])}function N0(i,e,t){let n=this.cache,r=e.length,s=ml(t,r);Zt(n,s)||(i.uniform1iv(this.addr,s),Jt(n,s));for(let o=0;o!==r;++o)t.setTexture2DArray(e[o]||Xp,s[o])}function B0(i){switch(i){case 5126:return M0;case 35664:return y0;case 35665:return v0;case 35666:return S0;case 35674:return E0;case 35675:return b0;case 35676:return T0;case 5124:case 35670:return A0;case 35667:case 35671:return R0;case 35668:case 35672:return w0;case 35669:case 35673:return C0;case 5125:return P0;case 36294:return F0;case 36295:return D0;case 36296:return L0;case 35678:case 36198:case 36298:case 36306:case 35682:return U0;case 35679:case 36299:case 36307:return I0;case 35680:case 36300:case 36308:case 36293:return O0;case 36289:case 36303:case 36311:case 36292:return N0}}var Xc=class{constructor(e,t,n){this.id=e,this.addr=n,this.cache=[],this.type=t.type,this.setValue=x0(t.type)}},qc=class{constructor(e,t,n){this.id=e,this.addr=n,this.cache=[],this.type=t.type,this.size=t.size,this.setValue=B0(t.type)}},Yc=class{constructor(e){this.id=e,this.seq=[],this.map={}}setValue(e,t,n){let r=this.seq;for(let s=0,o=r.length;s!==o;++s){let a=r[s];a.setValue(e,t[a.id],n)}}},Wc=/(\w+)(\])?(\[|\.)?/g;function kp(i,e){i.seq.push(e),i.map[e.id]=e}function G0(i,e,t){let n=i.name,r=n.length;for(Wc.lastIndex=0;;){let s=Wc.exec(n),o=Wc.lastIndex,a=s[1],l=s[2]==="]",c=s[3];if(l&&(a=a|0),c===void 0||c==="["&&o+2===r){kp(t,c===void 0?new Xc(a,i,e):new qc(a,i,e));break}else{let h=t.map[a];h===void 0&&(h=new Yc(a),kp(t,h)),t=h}}}var lr=class{constructor(e,t){this.seq=[],this.map={};let n=e.getProgramParameter(t,e.ACTIVE_UNIFORMS);for(let o=0;o<n;++o){let a=e.getActiveUniform(t,o),l=e.getUniformLocation(t,a.name);G0(a,l,this)}let r=[],s=[];for(let o of this.seq)o.type===e.SAMPLER_2D_SHADOW||o.type===e.SAMPLER_CUBE_SHADOW||o.type===e.SAMPLER_2D_ARRAY_SHADOW?r.push(o):s.push(o);r.length>0&&(this.seq=r.concat(s))}setValue(e,t,n,r){let s=this.map[t];s!==void 0&&s.setValue(e,n,r)}setOptional(e,t,n){let r=t[n];r!==void 0&&this.setValue(e,n,r)}static upload(e,t,n,r){for(let s=0,o=t.length;s!==o;++s){let a=t[s],l=n[a.id];l.needsUpdate!==!1&&a.setValue(e,l.value,r)}}static seqWithValue(e,t){let n=[];for(let r=0,s=e.length;r!==s;++r){let o=e[r];o.id in t&&n.push(o)}return n}};function $c(i,e,t){let n=i.createShader(e);return i.shaderSource(n,t),i.compileShader(n),n}var z0=37297,k0=0;function H0(i,e){let t=i.split(`
`),n=[],r=Math.max(e-6,0),s=Math.min(e+6,t.length);for(let o=r;o<s;o++){let a=o+1;n.push(`${a===e?">":" "} ${a}: ${t[o]}`)}return n.join(`
`)}var $p=new ke;function V0(i){je._getMatrix($p,je.workingColorSpace,i);let e=`mat3( ${$p.elements.map(t=>t.toFixed(4))} )`;switch(je.getTransfer(i)){case yr:return[e,"LinearTransferOETF"];case lt:return[e,"sRGBTransferOETF"];default:return Ce("WebGLProgram: Unsupported color space: ",i),[e,"LinearTransferOETF"]}}function Kp(i,e,t){let n=i.getShaderParameter(e,i.COMPILE_STATUS),s=(i.getShaderInfoLog(e)||"").trim();if(n&&s==="")return"";let o=/ERROR: 0:(\d+)/.exec(s);if(o){let a=parseInt(o[1]);return t.toUpperCase()+`

`+s+`

`+H0(i.getShaderSource(e),a)}else return s}function W0(i,e){let t=V0(e);return[`vec4 ${i}( vec4 value ) {`,`	return ${t[1]}( vec4( ${t[0]} * value.rgb, value.a ) );`,"}"].join(`
`)}var X0={[oa]:"Linear",[aa]:"Reinhard",[la]:"Cineon",[ca]:"ACESFilmic",[fa]:"AgX",[ha]:"Neutral",[ua]:"Custom"};function q0(i,e){let t=X0[e];return t===void 0?(Ce("WebGLProgram: Unsupported toneMapping:",e),"vec3 "+i+"( vec3 color ) { return LinearToneMapping( color ); }"):"vec3 "+i+"( vec3 color ) { return "+t+"ToneMapping( color ); }"}var _l=new I;function Y0(){je.getLuminanceCoefficients(_l);let i=_l.x.toFixed(4),e=_l.y.toFixed(4),t=_l.z.toFixed(4);return["float luminance( const in vec3 rgb ) {",`	const vec3 weights = vec3( ${i}, ${e}, ${t} );`,"	return dot( weights, rgb );","}"].join(`
`)}function $0(i){return[i.extensionClipCullDistance?"#extension GL_ANGLE_clip_cull_distance : require":"",i.extensionMultiDraw?"#extension GL_ANGLE_multi_draw : require":""].filter(Io).join(`
`)}function K0(i){let e=[];for(let t in i){let n=i[t];n!==!1&&e.push("#define "+t+" "+n)}return e.join(`
`)}function Z0(i,e){let t={},n=i.getProgramParameter(e,i.ACTIVE_ATTRIBUTES);for(let r=0;r<n;r++){let s=i.getActiveAttrib(e,r),o=s.name,a=1;s.type===i.FLOAT_MAT2&&(a=2),s.type===i.FLOAT_MAT3&&(a=3),s.type===i.FLOAT_MAT4&&(a=4),t[o]={type:s.type,location:i.getAttribLocation(e,o),locationSize:a}}return t}function Io(i){return i!==""}function Zp(i,e){let t=e.numSpotLightShadows+e.numSpotLightMaps-e.numSpotLightShadowsWithMaps;return i.replace(/NUM_SUN_LIGHTS/g,e.numSunLights).replace(/NUM_DIR_LIGHTS/g,e.numDirLights).replace(/NUM_SPOT_LIGHTS/g,e.numSpotLights).replace(/NUM_SPOT_LIGHT_MAPS/g,e.numSpotLightMaps).replace(/NUM_SPOT_LIGHT_COORDS/g,t).replace(/NUM_RECT_AREA_LIGHTS/g,e.numRectAreaLights).replace(/NUM_POINT_LIGHTS/g,e.numPointLights).replace(/NUM_HEMI_LIGHTS/g,e.numHemiLights).replace(/NUM_SUN_LIGHT_SHADOWS/g,e.numSunLightShadows).replace(/NUM_DIR_LIGHT_SHADOWS/g,e.numDirLightShadows).replace(/NUM_SPOT_LIGHT_SHADOWS_WITH_MAPS/g,e.numSpotLightShadowsWithMaps).replace(/NUM_SPOT_LIGHT_SHADOWS/g,e.numSpotLightShadows).replace(/NUM_POINT_LIGHT_SHADOWS/g,e.numPointLightShadows).replace(/NUM_LIGHT_PROBE_GRIDS/g,e.numLightProbeGrids)}function Jp(i,e){return i.replace(/NUM_CLIPPING_PLANES/g,e.numClippingPlanes).replace(/UNION_CLIPPING_PLANES/g,e.numClippingPlanes-e.numClipIntersection)}var J0=/^[ \t]*#include +<([\w\d./]+)>/gm;function Kc(i){return i.replace(J0,j0)}function j0(i,e){let t=it[e];if(t===void 0)throw new Error("THREE.WebGLProgram: Can not resolve #include <"+e+">");return Kc(t)}var Q0=/#pragma unroll_loop_start\s+for\s*\(\s*int\s+i\s*=\s*(\d+)\s*;\s*i\s*<\s*(\d+)\s*;\s*i\s*\+\+\s*\)\s*{([\s\S]+?)}\s+#pragma unroll_loop_end/g;function jp(i){return i.replace(Q0,eM)}function eM(i,e,t,n){let r="";for(let s=parseInt(e);s<parseInt(t);s++)r+=n.replace(/\[\s*i\s*\]/g,"[ "+s+" ]").replace(/UNROLLED_LOOP_INDEX/g,s);return r}function Qp(i){let e=`precision ${i.precision} float;
	precision ${i.precision} int;
	precision ${i.precision} sampler2D;
	precision ${i.precision} samplerCube;
	precision ${i.precision} sampler3D;
	precision ${i.precision} sampler2DArray;
	precision ${i.precision} sampler2DShadow;
	precision ${i.precision} samplerCubeShadow;
	precision ${i.precision} sampler2DArrayShadow;
	precision ${i.precision} isampler2D;
	precision ${i.precision} isampler3D;
	precision ${i.precision} isamplerCube;
	precision ${i.precision} isampler2DArray;
	precision ${i.precision} usampler2D;
	precision ${i.precision} usampler3D;
	precision ${i.precision} usamplerCube;
	precision ${i.precision} usampler2DArray;
	`;return i.precision==="highp"?e+=`
#define HIGH_PRECISION`:i.precision==="mediump"?e+=`
#define MEDIUM_PRECISION`:i.precision==="lowp"&&(e+=`
#define LOW_PRECISION`),e}var tM={[Hr]:"SHADOWMAP_TYPE_PCF",[_r]:"SHADOWMAP_TYPE_VSM"};function iM(i){return tM[i.shadowMapType]||"SHADOWMAP_TYPE_BASIC"}var nM={[Zn]:"ENVMAP_MODE_REFRACTION"};function rM(i){return i.envMap===!1?"ENVMAP_MODE_REFLECTION":nM[i.envMapMode]||"ENVMAP_MODE_REFLECTION"}var sM={[sa]:"ENVMAP_BLENDING_MULTIPLY",[tf]:"ENVMAP_BLENDING_MIX",[nf]:"ENVMAP_BLENDING_ADD"};function oM(i){return i.envMap===!1?"ENVMAP_BLENDING_NONE":sM[i.combine]||"ENVMAP_BLENDING_NONE"}function em(i,e,t,n){let r=i.getContext(),s=t.defines,o=t.vertexShader,a=t.fragmentShader,l=iM(t),c=t.envMapPMREM===!0?"ENVMAP_TYPE_PMREM":"ENVMAP_TYPE_CUBE",u=rM(t),h=oM(t),d=$0(t),g=K0(s),M=r.createProgram(),S,_,m=t.glslVersion?"#version "+t.glslVersion+`
`:"";t.isRawShaderMaterial?(S=["#define SHADER_TYPE "+t.shaderType,"#define SHADER_NAME "+t.shaderName,g].filter(Io).join(`
`),S.length>0&&(S+=`
`),_=["#define SHADER_TYPE "+t.shaderType,"#define SHADER_NAME "+t.shaderName,g].filter(Io).join(`
`),_.length>0&&(_+=`
`)):(S=[Qp(t),"#define SHADER_TYPE "+t.shaderType,"#define SHADER_NAME "+t.shaderName,g,t.extensionClipCullDistance?"#define USE_CLIP_DISTANCE":"",t.batching?"#define USE_BATCHING":"",t.batchingColor?"#define USE_BATCHING_COLOR":"",t.instancing?"#define USE_INSTANCING":"",t.instancingColor?"#define USE_INSTANCING_COLOR":"",t.instancingMorph?"#define USE_INSTANCING_MORPH":"",t.useFog&&t.fog?"#define USE_FOG":"",t.useFog&&t.fogExp2?"#define FOG_EXP2":"",t.map?"#define USE_MAP":"",t.envMap?"#define USE_ENVMAP":"",t.envMap?"#define "+u:"",t.lightMap?"#define USE_LIGHTMAP":"",t.aoMap?"#define USE_AOMAP":"",t.bumpMap?"#define USE_BUMPMAP":"",t.normalMap?"#define USE_NORMALMAP":"",t.normalMapObjectSpace?"#define USE_NORMALMAP_OBJECTSPACE":"",t.normalMapTangentSpace?"#define USE_NORMALMAP_TANGENTSPACE":"",t.displacementMap?"#define USE_DISPLACEMENTMAP":"",t.emissiveMap?"#define USE_EMISSIVEMAP":"",t.anisotropy?"#define USE_ANISOTROPY":"",t.anisotropyMap?"#define USE_ANISOTROPYMAP":"",t.clearcoatMap?"#define USE_CLEARCOATMAP":"",t.clearcoatRoughnessMap?"#define USE_CLEARCOAT_ROUGHNESSMAP":"",t.clearcoatNormalMap?"#define USE_CLEARCOAT_NORMALMAP":"",t.diffuseRoughnessMap?"#define USE_DIFFUSE_ROUGHNESSMAP":"",t.iridescenceMap?"#define USE_IRIDESCENCEMAP":"",t.iridescenceThicknessMap?"#define USE_IRIDESCENCE_THICKNESSMAP":"",t.specularMap?"#define USE_SPECULARMAP":"",t.specularColorMap?"#define USE_SPECULAR_COLORMAP":"",t.specularIntensityMap?"#define USE_SPECULAR_INTENSITYMAP":"",t.roughnessMap?"#define USE_ROUGHNESSMAP":"",t.metalnessMap?"#define USE_METALNESSMAP":"",t.alphaMap?"#define USE_ALPHAMAP":"",t.alphaHash?"#define USE_ALPHAHASH":"",t.transmission?"#define USE_TRANSMISSION":"",t.transmissionMap?"#define USE_TRANSMISSIONMAP":"",t.thicknessMap?"#define USE_THICKNESSMAP":"",t.sheenColorMap?"#define USE_SHEEN_COLORMAP":"",t.sheenRoughnessMap?"#define USE_SHEEN_ROUGHNESSMAP":"",t.mapUv?"#define MAP_UV "+t.mapUv:"",t.alphaMapUv?"#define ALPHAMAP_UV "+t.alphaMapUv:"",t.lightMapUv?"#define LIGHTMAP_UV "+t.lightMapUv:"",t.aoMapUv?"#define AOMAP_UV "+t.aoMapUv:"",t.emissiveMapUv?"#define EMISSIVEMAP_UV "+t.emissiveMapUv:"",t.bumpMapUv?"#define BUMPMAP_UV "+t.bumpMapUv:"",t.normalMapUv?"#define NORMALMAP_UV "+t.normalMapUv:"",t.displacementMapUv?"#define DISPLACEMENTMAP_UV "+t.displacementMapUv:"",t.metalnessMapUv?"#define METALNESSMAP_UV "+t.metalnessMapUv:"",t.roughnessMapUv?"#define ROUGHNESSMAP_UV "+t.roughnessMapUv:"",t.anisotropyMapUv?"#define ANISOTROPYMAP_UV "+t.anisotropyMapUv:"",t.clearcoatMapUv?"#define CLEARCOATMAP_UV "+t.clearcoatMapUv:"",t.clearcoatNormalMapUv?"#define CLEARCOAT_NORMALMAP_UV "+t.clearcoatNormalMapUv:"",t.clearcoatRoughnessMapUv?"#define CLEARCOAT_ROUGHNESSMAP_UV "+t.clearcoatRoughnessMapUv:"",t.diffuseRoughnessMapUv?"#define DIFFUSE_ROUGHNESSMAP_UV "+t.diffuseRoughnessMapUv:"",t.iridescenceMapUv?"#define IRIDESCENCEMAP_UV "+t.iridescenceMapUv:"",t.iridescenceThicknessMapUv?"#define IRIDESCENCE_THICKNESSMAP_UV "+t.iridescenceThicknessMapUv:"",t.sheenColorMapUv?"#define SHEEN_COLORMAP_UV "+t.sheenColorMapUv:"",t.sheenRoughnessMapUv?"#define SHEEN_ROUGHNESSMAP_UV "+t.sheenRoughnessMapUv:"",t.specularMapUv?"#define SPECULARMAP_UV "+t.specularMapUv:"",t.specularColorMapUv?"#define SPECULAR_COLORMAP_UV "+t.specularColorMapUv:"",t.specularIntensityMapUv?"#define SPECULAR_INTENSITYMAP_UV "+t.specularIntensityMapUv:"",t.transmissionMapUv?"#define TRANSMISSIONMAP_UV "+t.transmissionMapUv:"",t.thicknessMapUv?"#define THICKNESSMAP_UV "+t.thicknessMapUv:"",t.vertexTangents&&t.flatShading===!1?"#define USE_TANGENT":"",t.vertexNormals?"#define HAS_NORMAL":"",t.vertexColors?"#define USE_COLOR":"",t.vertexAlphas?"#define USE_COLOR_ALPHA":"",t.vertexUv1s?"#define USE_UV1":"",t.vertexUv2s?"#define USE_UV2":"",t.vertexUv3s?"#define USE_UV3":"",t.pointsUvs?"#define USE_POINTS_UV":"",t.flatShading?"#define FLAT_SHADED":"",t.skinning?"#define USE_SKINNING":"",t.morphTargets?"#define USE_MORPHTARGETS":"",t.morphNormals&&t.flatShading===!1?"#define USE_MORPHNORMALS":"",t.morphColors?"#define USE_MORPHCOLORS":"",t.morphTargetsCount>0?"#define MORPHTARGETS_TEXTURE_STRIDE "+t.morphTextureStride:"",t.morphTargetsCount>0?"#define MORPHTARGETS_COUNT "+t.morphTargetsCount:"",t.doubleSided?"#define DOUBLE_SIDED":"",t.flipSided?"#define FLIP_SIDED":"",t.shadowMapEnabled?"#define USE_SHADOWMAP":"",t.shadowMapEnabled?"#define "+l:"",t.sizeAttenuation?"#define USE_SIZEATTENUATION":"",t.numLightProbes>0?"#define USE_LIGHT_PROBES":"",t.logarithmicDepthBuffer?"#define USE_LOGARITHMIC_DEPTH_BUFFER":"",t.reversedDepthBuffer?"#define USE_REVERSED_DEPTH_BUFFER":"","uniform mat4 modelMatrix;","uniform mat4 modelViewMatrix;","uniform mat4 projectionMatrix;","uniform mat4 viewMatrix;","uniform mat3 normalMatrix;","uniform vec3 cameraPosition;","uniform bool isOrthographic;","#ifdef USE_INSTANCING","	attribute mat4 instanceMatrix;","#endif","#ifdef USE_INSTANCING_COLOR","	attribute vec3 instanceColor;","#endif","#ifdef USE_INSTANCING_MORPH","	uniform sampler2D morphTexture;","#endif","attribute vec3 position;","attribute vec3 normal;","attribute vec2 uv;","#ifdef USE_UV1","	attribute vec2 uv1;","#endif","#ifdef USE_UV2","	attribute vec2 uv2;","#endif","#ifdef USE_UV3","	attribute vec2 uv3;","#endif","#ifdef USE_TANGENT","	attribute vec4 tangent;","#endif","#if defined( USE_COLOR_ALPHA )","	attribute vec4 color;","#elif defined( USE_COLOR )","	attribute vec3 color;","#endif","#ifdef USE_SKINNING","	attribute vec4 skinIndex;","	attribute vec4 skinWeight;","#endif",`
`].filter(Io).join(`
`),_=[Qp(t),"#define SHADER_TYPE "+t.shaderType,"#define SHADER_NAME "+t.shaderName,g,t.useFog&&t.fog?"#define USE_FOG":"",t.useFog&&t.fogExp2?"#define FOG_EXP2":"",t.alphaToCoverage?"#define ALPHA_TO_COVERAGE":"",t.map?"#define USE_MAP":"",t.matcap?"#define USE_MATCAP":"",t.envMap?"#define USE_ENVMAP":"",t.envMap?"#define "+c:"",t.envMap?"#define "+u:"",t.envMap?"#define "+h:"",t.envMapPMREM?"#define ENVMAP_MAX_LOD "+t.envMapMaxLod+".0":"",t.envMapPMREM?"#define ENVMAP_SIZE "+t.envMapSize+".0":"",t.lightMap?"#define USE_LIGHTMAP":"",t.aoMap?"#define USE_AOMAP":"",t.bumpMap?"#define USE_BUMPMAP":"",t.normalMap?"#define USE_NORMALMAP":"",t.normalMapObjectSpace?"#define USE_NORMALMAP_OBJECTSPACE":"",t.normalMapTangentSpace?"#define USE_NORMALMAP_TANGENTSPACE":"",t.packedNormalMap?"#define USE_PACKED_NORMALMAP":"",t.emissiveMap?"#define USE_EMISSIVEMAP":"",t.anisotropy?"#define USE_ANISOTROPY":"",t.anisotropyMap?"#define USE_ANISOTROPYMAP":"",t.clearcoat?"#define USE_CLEARCOAT":"",t.clearcoatMap?"#define USE_CLEARCOATMAP":"",t.clearcoatRoughnessMap?"#define USE_CLEARCOAT_ROUGHNESSMAP":"",t.clearcoatNormalMap?"#define USE_CLEARCOAT_NORMALMAP":"",t.diffuseRoughness?"#define USE_DIFFUSE_ROUGHNESS":"",t.diffuseRoughnessMap?"#define USE_DIFFUSE_ROUGHNESSMAP":"",t.dispersion?"#define USE_DISPERSION":"",t.retroreflection?"#define USE_RETROREFLECTION":"",t.iridescence?"#define USE_IRIDESCENCE":"",t.iridescenceMap?"#define USE_IRIDESCENCEMAP":"",t.iridescenceThicknessMap?"#define USE_IRIDESCENCE_THICKNESSMAP":"",t.specularMap?"#define USE_SPECULARMAP":"",t.specularColorMap?"#define USE_SPECULAR_COLORMAP":"",t.specularIntensityMap?"#define USE_SPECULAR_INTENSITYMAP":"",t.roughnessMap?"#define USE_ROUGHNESSMAP":"",t.metalnessMap?"#define USE_METALNESSMAP":"",t.alphaMap?"#define USE_ALPHAMAP":"",t.alphaTest?"#define USE_ALPHATEST":"",t.alphaHash?"#define USE_ALPHAHASH":"",t.sheen?"#define USE_SHEEN":"",t.sheenColorMap?"#define USE_SHEEN_COLORMAP":"",t.sheenRoughnessMap?"#define USE_SHEEN_ROUGHNESSMAP":"",t.transmission?"#define USE_TRANSMISSION":"",t.transmissionMap?"#define USE_TRANSMISSIONMAP":"",t.thicknessMap?"#define USE_THICKNESSMAP":"",t.vertexTangents&&t.flatShading===!1?"#define USE_TANGENT":"",t.vertexColors||t.instancingColor?"#define USE_COLOR":"",t.vertexAlphas||t.batchingColor?"#define USE_COLOR_ALPHA":"",t.vertexUv1s?"#define USE_UV1":"",t.vertexUv2s?"#define USE_UV2":"",t.vertexUv3s?"#define USE_UV3":"",t.pointsUvs?"#define USE_POINTS_UV":"",t.gradientMap?"#define USE_GRADIENTMAP":"",t.flatShading?"#define FLAT_SHADED":"",t.doubleSided?"#define DOUBLE_SIDED":"",t.flipSided?"#define FLIP_SIDED":"",t.shadowMapEnabled?"#define USE_SHADOWMAP":"",t.shadowMapEnabled?"#define "+l:"",t.premultipliedAlpha?"#define PREMULTIPLIED_ALPHA":"",t.numLightProbes>0?"#define USE_LIGHT_PROBES":"",t.decodeVideoTexture?"#define DECODE_VIDEO_TEXTURE":"",t.decodeVideoTextureEmissive?"#define DECODE_VIDEO_TEXTURE_EMISSIVE":"",t.logarithmicDepthBuffer?"#define USE_LOGARITHMIC_DEPTH_BUFFER":"",t.reversedDepthBuffer?"#define USE_REVERSED_DEPTH_BUFFER":"","uniform mat4 viewMatrix;","uniform vec3 cameraPosition;","uniform bool isOrthographic;",t.toneMapping!==zi?"#define TONE_MAPPING":"",t.toneMapping!==zi?it.tonemapping_pars_fragment:"",t.toneMapping!==zi?q0("toneMapping",t.toneMapping):"",t.dithering?"#define DITHERING":"",t.opaque?"#define OPAQUE":"",it.colorspace_pars_fragment,W0("linearToOutputTexel",t.outputColorSpace),Y0(),t.useDepthPacking?"#define DEPTH_PACKING "+t.depthPacking:"",`
`].filter(Io).join(`
`)),o=Kc(o),o=Zp(o,t),o=Jp(o,t),a=Kc(a),a=Zp(a,t),a=Jp(a,t),o=jp(o),a=jp(a),t.isRawShaderMaterial!==!0&&(m=`#version 300 es
`,S=[d,"#define attribute in","#define varying out","#define texture2D texture"].join(`
`)+`
`+S,_=["#define varying in",t.glslVersion===uc?"":"layout(location = 0) out highp vec4 pc_fragColor;",t.glslVersion===uc?"":"#define gl_FragColor pc_fragColor","#define gl_FragDepthEXT gl_FragDepth","#define texture2D texture","#define textureCube texture","#define texture2DProj textureProj","#define texture2DLodEXT textureLod","#define texture2DProjLodEXT textureProjLod","#define textureCubeLodEXT textureLod","#define texture2DGradEXT textureGrad","#define texture2DProjGradEXT textureProjGrad","#define textureCubeGradEXT textureGrad"].join(`
`)+`
`+_);let b=m+S+o,w=m+_+a,R=$c(r,r.VERTEX_SHADER,b),P=$c(r,r.FRAGMENT_SHADER,w);r.attachShader(M,R),r.attachShader(M,P),t.index0AttributeName!==void 0?r.bindAttribLocation(M,0,t.index0AttributeName):t.hasPositionAttribute===!0&&r.bindAttribLocation(M,0,"position"),r.linkProgram(M);function C(N){if(i.debug.checkShaderErrors){let G=r.getProgramInfoLog(M)||"",W=r.getShaderInfoLog(R)||"",ee=r.getShaderInfoLog(P)||"",U=G.trim(),$=W.trim(),ne=ee.trim(),O=!0,ue=!0;if(r.getProgramParameter(M,r.LINK_STATUS)===!1)if(O=!1,typeof i.debug.onShaderError=="function")i.debug.onShaderError(r,M,R,P);else{let K=Kp(r,R,"vertex"),re=Kp(r,P,"fragment");ot("WebGLProgram: Shader Error "+r.getError()+" - VALIDATE_STATUS "+r.getProgramParameter(M,r.VALIDATE_STATUS)+`

Material Name: `+N.name+`
Material Type: `+N.type+`

Program Info Log: `+U+`
`+K+`
`+re)}else U!==""?Ce("WebGLProgram: Program Info Log:",U):($===""||ne==="")&&(ue=!1);ue&&(N.diagnostics={runnable:O,programLog:U,vertexShader:{log:$,prefix:S},fragmentShader:{log:ne,prefix:_}})}r.deleteShader(R),r.deleteShader(P),x=new lr(r,M),A=Z0(r,M)}let x;this.getUniforms=function(){return x===void 0&&C(this),x};let A;this.getAttributes=function(){return A===void 0&&C(this),A};let V=t.rendererExtensionParallelShaderCompile===!1;return this.isReady=function(){return V===!1&&(V=r.getProgramParameter(M,z0)),V},this.destroy=function(){n.releaseStatesOfProgram(this),r.deleteProgram(M),this.program=void 0},this.type=t.shaderType,this.name=t.shaderName,this.id=k0++,this.cacheKey=e,this.usedTimes=1,this.program=M,this.vertexShader=R,this.fragmentShader=P,this}var aM=0,xl=class{constructor(){this.shaderCache=new Map,this.materialCache=new Map}update(e,t,n){let r=this._getShaderCacheForMaterial(e);return r.has(t)===!1&&(r.add(t),t.usedTimes++),r.has(n)===!1&&(r.add(n),n.usedTimes++),this}remove(e){let t=this.materialCache.get(e);for(let n of t)n.usedTimes--,n.usedTimes===0&&this.shaderCache.delete(n.code);return this.materialCache.delete(e),this}getVertexShaderStage(e){return this._getShaderStage(e.vertexShader)}getFragmentShaderStage(e){return this._getShaderStage(e.fragmentShader)}dispose(){this.shaderCache.clear(),this.materialCache.clear()}_getShaderCacheForMaterial(e){let t=this.materialCache,n=t.get(e);return n===void 0&&(n=new Set,t.set(e,n)),n}_getShaderStage(e){let t=this.shaderCache,n=t.get(e);return n===void 0&&(n=new Zc(e),t.set(e,n)),n}},Zc=class{constructor(e){this.id=aM++,this.code=e,this.usedTimes=0}};function lM(i){return i===Vi||i===xr||i===Mr}function tm(i,e,t,n,r,s){let o=new er,a=new xl,l=new Set,c=[],u=new Map,h=n.logarithmicDepthBuffer,d={MeshDepthMaterial:"depth",MeshDistanceMaterial:"distance",MeshNormalMaterial:"normal",MeshBasicMaterial:"basic",MeshLambertMaterial:"lambert",MeshPhongMaterial:"phong",MeshToonMaterial:"toon",MeshStandardMaterial:"physical",MeshPhysicalMaterial:"physical",MeshMatcapMaterial:"matcap",LineBasicMaterial:"basic",LineDashedMaterial:"dashed",PointsMaterial:"points",ShadowMaterial:"shadow",SpriteMaterial:"sprite"};function g(x){return l.add(x),x===0?"uv":`uv${x}`}function M(x,A,V,N,G,W){let ee=N.fog,U=G.geometry,$=x.isMeshStandardMaterial||x.isMeshLambertMaterial||x.isMeshPhongMaterial?N.environment:null,ne=x.isMeshStandardMaterial||x.isMeshLambertMaterial&&!x.envMap||x.isMeshPhongMaterial&&!x.envMap,O=e.get(x.envMap||$,ne),ue=d[x.type],K=n.precision;x.precision!==null&&(K=n.getMaxPrecision(x.precision),K!==x.precision&&Ce("WebGLProgram.getParameters:",x.precision,"not supported, using",K,"instead."));let re=U.morphAttributes.position||U.morphAttributes.normal||U.morphAttributes.color,le=re!==void 0?re.length:0,Ue=0;U.morphAttributes.position!==void 0&&(Ue=1),U.morphAttributes.normal!==void 0&&(Ue=2),U.morphAttributes.color!==void 0&&(Ue=3);let Ze,Q,_e,Ee;if(ue){let Te=nn[ue];Ze=Te.vertexShader,Q=Te.fragmentShader}else{Ze=x.vertexShader,Q=x.fragmentShader;let Te=a.getVertexShaderStage(x),gt=a.getFragmentShaderStage(x);a.update(x,Te,gt),_e=Te.id,Ee=gt.id}let Ge=i.getRenderTarget(),be=i.state.buffers.depth.getReversed(),Fe=G.isInstancedMesh===!0,Ye=G.isBatchedMesh===!0,Ve=!!x.map,dt=!!x.matcap,yt=!!O,st=yt&&O.isPMREMTexture===!0,zt=!!x.aoMap,bt=!!x.lightMap,pi=!!x.bumpMap&&x.wireframe===!1,At=!!x.normalMap,Bi=!!x.displacementMap,kt=!!x.emissiveMap,Ri=!!x.metalnessMap,mi=!!x.roughnessMap,Pi=x.anisotropy>0,B=x.clearcoat>0,Fi=x.diffuseRoughness>0,wt=x.dispersion>0,Ct=x.retroreflectivity>0,Se=x.iridescence>0,Rt=x.sheen>0,Be=x.transmission>0,We=Pi&&!!x.anisotropyMap,T=B&&!!x.clearcoatMap,y=B&&!!x.clearcoatNormalMap,k=B&&!!x.clearcoatRoughnessMap,oe=Fi&&!!x.diffuseRoughnessMap,J=Se&&!!x.iridescenceMap,me=Se&&!!x.iridescenceThicknessMap,Me=Rt&&!!x.sheenColorMap,j=Rt&&!!x.sheenRoughnessMap,q=!!x.specularMap,ce=!!x.specularColorMap,F=!!x.specularIntensityMap,ie=Be&&!!x.transmissionMap,Z=Be&&!!x.thicknessMap,ye=!!x.gradientMap,de=!!x.alphaMap,ge=x.alphaTest>0,Ne=!!x.alphaHash,nt=!!x.extensions,fe=zi;x.toneMapped&&(Ge===null||Ge.isXRRenderTarget===!0)&&(fe=i.toneMapping);let He=st?O.isCompressedCubeTexture?O.image[0].mipmaps:O.mipmaps:null,Xe={shaderID:ue,shaderType:x.type,shaderName:x.name,vertexShader:Ze,fragmentShader:Q,defines:x.defines,customVertexShaderID:_e,customFragmentShaderID:Ee,isRawShaderMaterial:x.isRawShaderMaterial===!0,glslVersion:x.glslVersion,precision:K,batching:Ye,batchingColor:Ye&&G._colorsTexture!==null,instancing:Fe,instancingColor:Fe&&G.instanceColor!==null,instancingMorph:Fe&&G.morphTexture!==null,outputColorSpace:Ge===null?i.outputColorSpace:Ge.isXRRenderTarget===!0?Ge.texture.colorSpace:je.workingColorSpace,alphaToCoverage:!!x.alphaToCoverage,map:Ve,matcap:dt,envMap:yt,envMapMode:yt&&O.mapping,envMapPMREM:st,envMapMaxLod:st?He.length-1:null,envMapSize:st?He[0].width:null,aoMap:zt,lightMap:bt,bumpMap:pi,normalMap:At,displacementMap:Bi,emissiveMap:kt,normalMapObjectSpace:At&&x.normalMapType===of,normalMapTangentSpace:At&&x.normalMapType===cc,packedNormalMap:At&&x.normalMapType===cc&&lM(x.normalMap.format),metalnessMap:Ri,roughnessMap:mi,anisotropy:Pi,anisotropyMap:We,clearcoat:B,clearcoatMap:T,clearcoatNormalMap:y,clearcoatRoughnessMap:k,diffuseRoughness:Fi,diffuseRoughnessMap:oe,dispersion:wt,retroreflection:Ct,iridescence:Se,iridescenceMap:J,iridescenceThicknessMap:me,sheen:Rt,sheenColorMap:Me,sheenRoughnessMap:j,specularMap:q,specularColorMap:ce,specularIntensityMap:F,transmission:Be,transmissionMap:ie,thicknessMap:Z,gradientMap:ye,opaque:x.transparent===!1&&x.blending===Yn&&x.alphaToCoverage===!1,alphaMap:de,alphaTest:ge,alphaHash:Ne,combine:x.combine,mapUv:Ve&&g(x.map.channel),aoMapUv:zt&&g(x.aoMap.channel),lightMapUv:bt&&g(x.lightMap.channel),bumpMapUv:pi&&g(x.bumpMap.channel),normalMapUv:At&&g(x.normalMap.channel),displacementMapUv:Bi&&g(x.displacementMap.channel),emissiveMapUv:kt&&g(x.emissiveMap.channel),metalnessMapUv:Ri&&g(x.metalnessMap.channel),roughnessMapUv:mi&&g(x.roughnessMap.channel),anisotropyMapUv:We&&g(x.anisotropyMap.channel),clearcoatMapUv:T&&g(x.clearcoatMap.channel),clearcoatNormalMapUv:y&&g(x.clearcoatNormalMap.channel),clearcoatRoughnessMapUv:k&&g(x.clearcoatRoughnessMap.channel),diffuseRoughnessMapUv:oe&&g(x.diffuseRoughnessMap.channel),iridescenceMapUv:J&&g(x.iridescenceMap.channel),iridescenceThicknessMapUv:me&&g(x.iridescenceThicknessMap.channel),sheenColorMapUv:Me&&g(x.sheenColorMap.channel),sheenRoughnessMapUv:j&&g(x.sheenRoughnessMap.channel),specularMapUv:q&&g(x.specularMap.channel),specularColorMapUv:ce&&g(x.specularColorMap.channel),specularIntensityMapUv:F&&g(x.specularIntensityMap.channel),transmissionMapUv:ie&&g(x.transmissionMap.channel),thicknessMapUv:Z&&g(x.thicknessMap.channel),alphaMapUv:de&&g(x.alphaMap.channel),vertexTangents:!!U.attributes.tangent&&(At||Pi),vertexNormals:!!U.attributes.normal,vertexColors:x.vertexColors,vertexAlphas:x.vertexColors===!0&&!!U.attributes.color&&U.attributes.color.itemSize===4,pointsUvs:G.isPoints===!0&&!!U.attributes.uv&&(Ve||de),fog:!!ee,useFog:x.fog===!0,fogExp2:!!ee&&ee.isFogExp2,flatShading:x.wireframe===!1&&(x.flatShading===!0||U.attributes.normal===void 0&&At===!1&&(x.isMeshLambertMaterial||x.isMeshPhongMaterial||x.isMeshStandardMaterial||x.isMeshPhysicalMaterial)),sizeAttenuation:x.sizeAttenuation===!0,logarithmicDepthBuffer:h,reversedDepthBuffer:be,skinning:G.isSkinnedMesh===!0,hasPositionAttribute:U.attributes.position!==void 0,morphTargets:U.morphAttributes.position!==void 0,morphNormals:U.morphAttributes.normal!==void 0,morphColors:U.morphAttributes.color!==void 0,morphTargetsCount:le,morphTextureStride:Ue,numSunLights:A.sun.length,numDirLights:A.directional.length,numPointLights:A.point.length,numSpotLights:A.spot.length,numSpotLightMaps:A.spotLightMap.length,numRectAreaLights:A.rectArea.length,numHemiLights:A.hemi.length,numSunLightShadows:A.sunShadowMap.length,numDirLightShadows:A.directionalShadowMap.length,numPointLightShadows:A.pointShadowMap.length,numSpotLightShadows:A.spotShadowMap.length,numSpotLightShadowsWithMaps:A.numSpotLightShadowsWithMaps,numLightProbes:A.numLightProbes,numLightProbeGrids:W.filter(Te=>Te.texture!==null).length,numClippingPlanes:s.numPlanes,numClipIntersection:s.numIntersection,dithering:x.dithering,shadowMapEnabled:i.shadowMap.enabled&&V.length>0,shadowMapType:i.shadowMap.type,toneMapping:fe,decodeVideoTexture:Ve&&x.map.isVideoTexture===!0&&je.getTransfer(x.map.colorSpace)===lt,decodeVideoTextureEmissive:kt&&x.emissiveMap.isVideoTexture===!0&&je.getTransfer(x.emissiveMap.colorSpace)===lt,premultipliedAlpha:x.premultipliedAlpha,doubleSided:x.side===wi,flipSided:x.side===Ot,useDepthPacking:x.depthPacking>=0,depthPacking:x.depthPacking||0,index0AttributeName:x.index0AttributeName,extensionClipCullDistance:nt&&x.extensions.clipCullDistance===!0&&t.has("WEBGL_clip_cull_distance"),extensionMultiDraw:(nt&&x.extensions.multiDraw===!0||Ye)&&t.has("WEBGL_multi_draw"),rendererExtensionParallelShaderCompile:t.has("KHR_parallel_shader_compile"),customProgramCacheKey:x.customProgramCacheKey()};return Xe.vertexUv1s=l.has(1),Xe.vertexUv2s=l.has(2),Xe.vertexUv3s=l.has(3),l.clear(),Xe}function S(x){let A=[];if(x.shaderID?A.push(x.shaderID):(A.push(x.customVertexShaderID),A.push(x.customFragmentShaderID)),x.defines!==void 0)for(let V in x.defines)A.push(V),A.push(x.defines[V]);return x.isRawShaderMaterial===!1&&(_(A,x),m(A,x),A.push(i.outputColorSpace)),A.push(x.customProgramCacheKey),A.join()}function _(x,A){x.push(A.precision),x.push(A.outputColorSpace),x.push(A.envMapMode),x.push(A.envMapPMREM),x.push(A.envMapMaxLod),x.push(A.envMapSize),x.push(A.mapUv),x.push(A.alphaMapUv),x.push(A.lightMapUv),x.push(A.aoMapUv),x.push(A.bumpMapUv),x.push(A.normalMapUv),x.push(A.displacementMapUv),x.push(A.emissiveMapUv),x.push(A.metalnessMapUv),x.push(A.roughnessMapUv),x.push(A.anisotropyMapUv),x.push(A.clearcoatMapUv),x.push(A.clearcoatNormalMapUv),x.push(A.clearcoatRoughnessMapUv),x.push(A.diffuseRoughnessMapUv),x.push(A.iridescenceMapUv),x.push(A.iridescenceThicknessMapUv),x.push(A.sheenColorMapUv),x.push(A.sheenRoughnessMapUv),x.push(A.specularMapUv),x.push(A.specularColorMapUv),x.push(A.specularIntensityMapUv),x.push(A.transmissionMapUv),x.push(A.thicknessMapUv),x.push(A.combine),x.push(A.fogExp2),x.push(A.sizeAttenuation),x.push(A.morphTargetsCount),x.push(A.numSunLights),x.push(A.numDirLights),x.push(A.numPointLights),x.push(A.numSpotLights),x.push(A.numSpotLightMaps),x.push(A.numHemiLights),x.push(A.numRectAreaLights),x.push(A.numSunLightShadows),x.push(A.numDirLightShadows),x.push(A.numPointLightShadows),x.push(A.numSpotLightShadows),x.push(A.numSpotLightShadowsWithMaps),x.push(A.numLightProbes),x.push(A.numLightProbeGrids),x.push(A.shadowMapType),x.push(A.toneMapping),x.push(A.numClippingPlanes),x.push(A.numClipIntersection),x.push(A.depthPacking)}function m(x,A){o.disableAll(),A.instancing&&o.enable(0),A.instancingColor&&o.enable(1),A.instancingMorph&&o.enable(2),A.matcap&&o.enable(3),A.envMap&&o.enable(4),A.normalMapObjectSpace&&o.enable(5),A.normalMapTangentSpace&&o.enable(6),A.clearcoat&&o.enable(7),A.iridescence&&o.enable(8),A.alphaTest&&o.enable(9),A.vertexColors&&o.enable(10),A.vertexAlphas&&o.enable(11),A.vertexUv1s&&o.enable(12),A.vertexUv2s&&o.enable(13),A.vertexUv3s&&o.enable(14),A.vertexTangents&&o.enable(15),A.anisotropy&&o.enable(16),A.alphaHash&&o.enable(17),A.batching&&o.enable(18),A.dispersion&&o.enable(19),A.retroreflection&&o.enable(24),A.diffuseRoughness&&o.enable(25),A.batchingColor&&o.enable(20),A.gradientMap&&o.enable(21),A.packedNormalMap&&o.enable(22),A.vertexNormals&&o.enable(23),x.push(o.mask),o.disableAll(),A.fog&&o.enable(0),A.useFog&&o.enable(1),A.flatShading&&o.enable(2),A.logarithmicDepthBuffer&&o.enable(3),A.reversedDepthBuffer&&o.enable(4),A.skinning&&o.enable(5),A.morphTargets&&o.enable(6),A.morphNormals&&o.enable(7),A.morphColors&&o.enable(8),A.premultipliedAlpha&&o.enable(9),A.shadowMapEnabled&&o.enable(10),A.doubleSided&&o.enable(11),A.flipSided&&o.enable(12),A.useDepthPacking&&o.enable(13),A.dithering&&o.enable(14),A.transmission&&o.enable(15),A.sheen&&o.enable(16),A.opaque&&o.enable(17),A.pointsUvs&&o.enable(18),A.decodeVideoTexture&&o.enable(19),A.decodeVideoTextureEmissive&&o.enable(20),A.alphaToCoverage&&o.enable(21),A.numLightProbeGrids>0&&o.enable(22),A.hasPositionAttribute&&o.enable(23),x.push(o.mask)}function b(x){let A=d[x.type],V;if(A){let N=nn[A];V=Xf.clone(N.uniforms)}else V=x.uniforms;return V}function w(x,A){let V=u.get(A);return V!==void 0?++V.usedTimes:(V=new em(i,A,x,r),c.push(V),u.set(A,V)),V}function R(x){if(--x.usedTimes===0){let A=c.indexOf(x);c[A]=c[c.length-1],c.pop(),u.delete(x.cacheKey),x.destroy()}}function P(x){a.remove(x)}function C(){a.dispose()}return{getParameters:M,getProgramCacheKey:S,getUniforms:b,acquireProgram:w,releaseProgram:R,releaseShaderCache:P,programs:c,dispose:C}}function im(){let i=new WeakMap;function e(o){return i.has(o)}function t(o){let a=i.get(o);return a===void 0&&(a={},i.set(o,a)),a}function n(o){i.delete(o)}function r(o,a,l){i.get(o)[a]=l}function s(){i=new WeakMap}return{has:e,get:t,remove:n,update:r,dispose:s}}function cM(i,e){return i.groupOrder!==e.groupOrder?i.groupOrder-e.groupOrder:i.renderOrder!==e.renderOrder?i.renderOrder-e.renderOrder:i.material.id!==e.material.id?i.material.id-e.material.id:i.materialVariant!==e.materialVariant?i.materialVariant-e.materialVariant:i.z!==e.z?i.z-e.z:i.id-e.id}function nm(i,e){return i.groupOrder!==e.groupOrder?i.groupOrder-e.groupOrder:i.renderOrder!==e.renderOrder?i.renderOrder-e.renderOrder:i.z!==e.z?e.z-i.z:i.id-e.id}function rm(){let i=[],e=0,t=[],n=[],r=[];function s(){e=0,t.length=0,n.length=0,r.length=0}function o(d){let g=0;return d.isInstancedMesh&&(g+=2),d.isSkinnedMesh&&(g+=1),g}function a(d,g,M,S,_,m){let b=i[e];return b===void 0?(b={id:d.id,object:d,geometry:g,material:M,materialVariant:o(d),groupOrder:S,renderOrder:d.renderOrder,z:_,group:m},i[e]=b):(b.id=d.id,b.object=d,b.geometry=g,b.material=M,b.materialVariant=o(d),b.groupOrder=S,b.renderOrder=d.renderOrder,b.z=_,b.group=m),e++,b}function l(d,g,M,S,_,m,b){b.reversedDepth===!0&&(_=-_);let w=a(d,g,M,S,_,m);M.transmission>0?n.push(w):M.transparent===!0?r.push(w):t.push(w)}function c(d,g,M,S,_,m){let b=a(d,g,M,S,_,m);M.transmission>0?n.unshift(b):M.transparent===!0?r.unshift(b):t.unshift(b)}function u(d,g){t.length>1&&t.sort(d||cM),n.length>1&&n.sort(g||nm),r.length>1&&r.sort(g||nm)}function h(){for(let d=e,g=i.length;d<g;d++){let M=i[d];if(M.id===null)break;M.id=null,M.object=null,M.geometry=null,M.material=null,M.group=null}}return{opaque:t,transmissive:n,transparent:r,init:s,push:l,unshift:c,finish:h,sort:u}}function sm(){let i=new WeakMap;function e(n,r){let s=i.get(n),o;return s===void 0?(o=new rm,i.set(n,[o])):r>=s.length?(o=new rm,s.push(o)):o=s[r],o}function t(){i=new WeakMap}return{get:e,dispose:t}}function uM(){let i={};return{get:function(e){if(i[e.id]!==void 0)return i[e.id];let t;switch(e.type){case"SunLight":case"DirectionalLight":t={direction:new I,color:new $e};break;case"SpotLight":t={position:new I,direction:new I,color:new $e,distance:0,coneCos:0,penumbraCos:0,decay:0};break;case"PointLight":t={position:new I,color:new $e,distance:0,decay:0};break;case"HemisphereLight":t={direction:new I,skyColor:new $e,groundColor:new $e};break;case"RectAreaLight":t={color:new $e,position:new I,halfWidth:new I,halfHeight:new I};break}return i[e.id]=t,t}}}function fM(){let i={};return{get:function(e){if(i[e.id]!==void 0)return i[e.id];let t;switch(e.type){case"SunLight":case"DirectionalLight":t={shadowIntensity:1,shadowBias:0,shadowNormalBias:0,shadowRadius:1,shadowMapSize:new Oe};break;case"SpotLight":t={shadowIntensity:1,shadowBias:0,shadowNormalBias:0,shadowRadius:1,shadowMapSize:new Oe};break;case"PointLight":t={shadowIntensity:1,shadowBias:0,shadowNormalBias:0,shadowRadius:1,shadowMapSize:new Oe,shadowCameraNear:1,shadowCameraFar:1e3};break}return i[e.id]=t,t}}}var hM=0;function dM(i,e){return(e.castShadow?2:0)-(i.castShadow?2:0)+(e.map?1:0)-(i.map?1:0)}function om(i){let e=new uM,t=fM(),n={version:0,hash:{sunLength:-1,directionalLength:-1,pointLength:-1,spotLength:-1,rectAreaLength:-1,hemiLength:-1,numSunShadows:-1,numDirectionalShadows:-1,numPointShadows:-1,numSpotShadows:-1,numSpotMaps:-1,numLightProbes:-1},ambient:[0,0,0],probe:[],sun:[],sunShadow:[],sunShadowMap:[],sunShadowMatrix:[],sunShadowCascade:[],directional:[],directionalShadow:[],directionalShadowMap:[],directionalShadowMatrix:[],spot:[],spotLightMap:[],spotShadow:[],spotShadowMap:[],spotLightMatrix:[],rectArea:[],rectAreaLTC1:null,rectAreaLTC2:null,point:[],pointShadow:[],pointShadowMap:[],pointShadowMatrix:[],hemi:[],numSpotLightShadowsWithMaps:0,numLightProbes:0};for(let c=0;c<9;c++)n.probe.push(new I);let r=new I,s=new tt,o=new tt;function a(c){let u=0,h=0,d=0;for(let W=0;W<9;W++)n.probe[W].set(0,0,0);let g=0,M=0,S=0,_=0,m=0,b=0,w=0,R=0,P=0,C=0,x=0,A=0,V=0,N=0;c.sort(dM);for(let W=0,ee=c.length;W<ee;W++){let U=c[W],$=U.color,ne=U.intensity,O=U.distance,ue=null;if(U.shadow&&U.shadow.map&&(U.shadow.map.texture.format===Vi?ue=U.shadow.map.texture:ue=U.shadow.map.depthTexture||U.shadow.map.texture),U.isAmbientLight)u+=$.r*ne,h+=$.g*ne,d+=$.b*ne;else if(U.isLightProbe){for(let K=0;K<9;K++)n.probe[K].addScaledVector(U.sh.coefficients[K],ne);N++}else if(U.isSunLight){let K=e.get(U);if(K.color.copy(U.color).multiplyScalar(U.intensity),U.castShadow){let re=U.shadow,le=t.get(U);le.shadowIntensity=re.intensity,le.shadowBias=re.bias,le.shadowNormalBias=re.normalBias,le.shadowRadius=re.radius,le.shadowMapSize.copy(re.mapSize).multiply(re.getFrameExtents()),n.sunShadow[M]=le,n.sunShadowMap[M]=ue;let Ue=re.getViewportCount();for(let Ze=0;Ze<Ue;Ze++)n.sunShadowMatrix[S+Ze]=re.getMatrix(Ze),n.sunShadowCascade[S+Ze]=re._cascadeData[Ze];S+=Ue,M++}n.sun[g]=K,g++}else if(U.isDirectionalLight){let K=e.get(U);if(K.color.copy(U.color).multiplyScalar(U.intensity),U.castShadow){let re=U.shadow,le=t.get(U);le.shadowIntensity=re.intensity,le.shadowBias=re.bias,le.shadowNormalBias=re.normalBias,le.shadowRadius=re.radius,le.shadowMapSize=re.mapSize,n.directionalShadow[_]=le,n.directionalShadowMap[_]=ue,n.directionalShadowMatrix[_]=U.shadow.matrix,P++}n.directional[_]=K,_++}else if(U.isSpotLight){let K=e.get(U);K.position.setFromMatrixPosition(U.matrixWorld),K.color.copy($).multiplyScalar(ne),K.distance=O,K.coneCos=Math.cos(U.angle),K.penumbraCos=Math.cos(U.angle*(1-U.penumbra)),K.decay=U.decay,n.spot[b]=K;let re=U.shadow;if(U.map&&(n.spotLightMap[A]=U.map,A++,re.updateMatrices(U),U.castShadow&&V++),n.spotLightMatrix[b]=re.matrix,U.castShadow){let le=t.get(U);le.shadowIntensity=re.intensity,le.shadowBias=re.bias,le.shadowNormalBias=re.normalBias,le.shadowRadius=re.radius,le.shadowMapSize=re.mapSize,n.spotShadow[b]=le,n.spotShadowMap[b]=ue,x++}b++}else if(U.isRectAreaLight){let K=e.get(U);K.color.copy($).multiplyScalar(ne),K.halfWidth.set(U.width*.5,0,0),K.halfHeight.set(0,U.height*.5,0),n.rectArea[w]=K,w++}else if(U.isPointLight){let K=e.get(U);if(K.color.copy(U.color).multiplyScalar(U.intensity),K.distance=U.distance,K.decay=U.decay,U.castShadow){let re=U.shadow,le=t.get(U);le.shadowIntensity=re.intensity,le.shadowBias=re.bias,le.shadowNormalBias=re.normalBias,le.shadowRadius=re.radius,le.shadowMapSize=re.mapSize,le.shadowCameraNear=re.camera.near,le.shadowCameraFar=re.camera.far,n.pointShadow[m]=le,n.pointShadowMap[m]=ue,n.pointShadowMatrix[m]=U.shadow.matrix,C++}n.point[m]=K,m++}else if(U.isHemisphereLight){let K=e.get(U);K.skyColor.copy(U.color).multiplyScalar(ne),K.groundColor.copy(U.groundColor).multiplyScalar(ne),n.hemi[R]=K,R++}}w>0&&(i.has("OES_texture_float_linear")===!0?(n.rectAreaLTC1=Ae.LTC_FLOAT_1,n.rectAreaLTC2=Ae.LTC_FLOAT_2):(n.rectAreaLTC1=Ae.LTC_HALF_1,n.rectAreaLTC2=Ae.LTC_HALF_2)),n.ambient[0]=u,n.ambient[1]=h,n.ambient[2]=d;let G=n.hash;(G.sunLength!==g||G.directionalLength!==_||G.pointLength!==m||G.spotLength!==b||G.rectAreaLength!==w||G.hemiLength!==R||G.numSunShadows!==M||G.numDirectionalShadows!==P||G.numPointShadows!==C||G.numSpotShadows!==x||G.numSpotMaps!==A||G.numLightProbes!==N)&&(n.sun.length=g,n.directional.length=_,n.spot.length=b,n.rectArea.length=w,n.point.length=m,n.hemi.length=R,n.sunShadow.length=M,n.sunShadowMap.length=M,n.sunShadowMatrix.length=S,n.sunShadowCascade.length=S,n.directionalShadow.length=P,n.directionalShadowMap.length=P,n.directionalShadowMatrix.length=P,n.pointShadow.length=C,n.pointShadowMap.length=C,n.pointShadowMatrix.length=C,n.spotShadow.length=x,n.spotShadowMap.length=x,n.spotLightMatrix.length=x+A-V,n.spotLightMap.length=A,n.numSpotLightShadowsWithMaps=V,n.numLightProbes=N,G.sunLength=g,G.directionalLength=_,G.pointLength=m,G.spotLength=b,G.rectAreaLength=w,G.hemiLength=R,G.numSunShadows=M,G.numDirectionalShadows=P,G.numPointShadows=C,G.numSpotShadows=x,G.numSpotMaps=A,G.numLightProbes=N,n.version=hM++)}function l(c,u){let h=0,d=0,g=0,M=0,S=0,_=0,m=u.matrixWorldInverse;for(let b=0,w=c.length;b<w;b++){let R=c[b];if(R.isSunLight){let P=n.sun[h];P.direction.setFromMatrixPosition(R.matrixWorld),P.direction.transformDirection(m),h++}else if(R.isDirectionalLight){let P=n.directional[d];P.direction.setFromMatrixPosition(R.matrixWorld),r.setFromMatrixPosition(R.target.matrixWorld),P.direction.sub(r),P.direction.transformDirection(m),d++}else if(R.isSpotLight){let P=n.spot[M];P.position.setFromMatrixPosition(R.matrixWorld),P.position.applyMatrix4(m),P.direction.setFromMatrixPosition(R.matrixWorld),r.setFromMatrixPosition(R.target.matrixWorld),P.direction.sub(r),P.direction.transformDirection(m),M++}else if(R.isRectAreaLight){let P=n.rectArea[S];P.position.setFromMatrixPosition(R.matrixWorld),P.position.applyMatrix4(m),o.identity(),s.copy(R.matrixWorld),s.premultiply(m),o.extractRotation(s),P.halfWidth.set(R.width*.5,0,0),P.halfHeight.set(0,R.height*.5,0),P.halfWidth.applyMatrix4(o),P.halfHeight.applyMatrix4(o),S++}else if(R.isPointLight){let P=n.point[g];P.position.setFromMatrixPosition(R.matrixWorld),P.position.applyMatrix4(m),g++}else if(R.isHemisphereLight){let P=n.hemi[_];P.direction.setFromMatrixPosition(R.matrixWorld),P.direction.transformDirection(m),_++}}}return{setup:a,setupView:l,state:n}}function am(i){let e=new om(i),t=[],n=[],r=[];function s(h){u.camera=h,t.length=0,n.length=0,r.length=0}function o(h){h.isLightProbeGrid?r.push(h):t.push(h)}function a(h){n.push(h)}function l(){e.setup(t),r.sort((h,d)=>h.priority-d.priority||h.id-d.id)}function c(h){e.setupView(t,h)}let u={lightsArray:t,shadowsArray:n,lightProbeGridArray:r,camera:null,lights:e,transmissionRenderTarget:{},textureUnits:0};return{init:s,state:u,setupLights:l,setupLightsView:c,pushLight:o,pushShadow:a}}function lm(i){let e=new WeakMap;function t(r,s=0){let o=e.get(r),a;return o===void 0?(a=new am(i),e.set(r,[a])):s>=o.length?(a=new am(i),o.push(a)):a=o[s],a}function n(){e=new WeakMap}return{get:t,dispose:n}}var cm=`
void main() {

	gl_Position = vec4( position, 1.0 );

}
`,um=`
uniform sampler2D shadow_pass;
uniform vec2 resolution;
uniform float radius;

void main() {

	const float samples = float( VSM_SAMPLES );

	float mean = 0.0;
	float squared_mean = 0.0;

	float uvStride = samples <= 1.0 ? 0.0 : 2.0 / ( samples - 1.0 );
	float uvStart = samples <= 1.0 ? 0.0 : - 1.0;
	for ( float i = 0.0; i < samples; i ++ ) {

		float uvOffset = uvStart + i * uvStride;

		#ifdef HORIZONTAL_PASS

			vec2 distribution = texture2D( shadow_pass, ( gl_FragCoord.xy + vec2( uvOffset, 0.0 ) * radius ) / resolution ).rg;
			mean += distribution.x;
			squared_mean += distribution.y * distribution.y + distribution.x * distribution.x;

		#else

			float depth = texture2D( shadow_pass, ( gl_FragCoord.xy + vec2( 0.0, uvOffset ) * radius ) / resolution ).r;
			mean += depth;
			squared_mean += depth * depth;

		#endif

	}

	mean = mean / samples;
	squared_mean = squared_mean / samples;

	float std_dev = sqrt( max( 0.0, squared_mean - mean * mean ) );

	gl_FragColor = vec4( mean, std_dev, 0.0, 1.0 );

}
`;var mM=[new I(1,0,0),new I(-1,0,0),new I(0,1,0),new I(0,-1,0),new I(0,0,1),new I(0,0,-1)],gM=[new I(0,-1,0),new I(0,-1,0),new I(0,0,1),new I(0,0,-1),new I(0,-1,0),new I(0,-1,0)],fm=new tt,Oo=new I,Jc=new I;function hm(i,e,t){let n=new tn,r=new Oe,s=new Oe,o=new vt,a=new sl,l=new ol,c={},u=t.maxTextureSize,h={[Ji]:Ot,[Ot]:Ji,[wi]:wi},d=new ai({defines:{VSM_SAMPLES:8},uniforms:{shadow_pass:{value:null},resolution:{value:new Oe},radius:{value:4}},vertexShader:cm,fragmentShader:um}),g=d.clone();g.defines.HORIZONTAL_PASS=1;let M=new Et;M.setAttribute("position",new ni(new Float32Array([-1,-1,.5,3,-1,.5,-1,3,.5]),3));let S=new oi(M,d),_=this;this.enabled=!1,this.autoUpdate=!0,this.needsUpdate=!1,this.type=Hr;let m=this.type;this.render=function(C,x,A){if(_.enabled===!1||_.autoUpdate===!1&&_.needsUpdate===!1||C.length===0)return;this.type===Ou&&(Ce("WebGLShadowMap: PCFSoftShadowMap has been removed. Using PCFShadowMap instead."),this.type=Hr);let V=i.getRenderTarget(),N=i.getActiveCubeFace(),G=i.getActiveMipmapLevel(),W=i.state;W.setBlending(yn),W.buffers.depth.getReversed()===!0?W.buffers.color.setClear(0,0,0,0):W.buffers.color.setClear(1,1,1,1),W.buffers.depth.setTest(!0),W.setScissorTest(!1);let ee=m!==this.type;ee&&x.traverse(function(U){U.material&&(Array.isArray(U.material)?U.material.forEach($=>$.needsUpdate=!0):U.material.needsUpdate=!0)});for(let U=0,$=C.length;U<$;U++){let ne=C[U],O=ne.shadow;if(O===void 0){Ce("WebGLShadowMap:",ne,"has no shadow.");continue}if(O.autoUpdate===!1&&O.needsUpdate===!1)continue;r.copy(O.mapSize);let ue=O.getFrameExtents();r.multiply(ue),s.copy(O.mapSize),(r.x>u||r.y>u)&&(r.x>u&&(s.x=Math.floor(u/ue.x),r.x=s.x*ue.x,O.mapSize.x=s.x),r.y>u&&(s.y=Math.floor(u/ue.y),r.y=s.y*ue.y,O.mapSize.y=s.y));let K=i.state.buffers.depth.getReversed();if(O.camera._reversedDepth=K,O.map===null||ee===!0){if(O.map!==null&&(O.map.depthTexture!==null&&(O.map.depthTexture.dispose(),O.map.depthTexture=null),O.map.dispose()),this.type===_r){if(ne.isPointLight){Ce("WebGLShadowMap: VSM shadow maps are not supported for PointLights. Use PCF or BasicShadowMap instead.");continue}O.map=new di(r.x,r.y,{format:Vi,type:ti,minFilter:Bt,magFilter:Bt,generateMipmaps:!1}),O.map.texture.name=ne.name+".shadowMap",O.map.depthTexture=new Ki(r.x,r.y,fi),O.map.depthTexture.name=ne.name+".shadowMapDepth",O.map.depthTexture.format=Ui,O.map.depthTexture.compareFunction=null,O.map.depthTexture.minFilter=Lt,O.map.depthTexture.magFilter=Lt}else ne.isPointLight?(O.map=new ar(r.x),O.map.depthTexture=new _s(r.x,ei)):(O.map=new di(r.x,r.y),O.map.depthTexture=new Ki(r.x,r.y,ei)),O.map.depthTexture.name=ne.name+".shadowMap",O.map.depthTexture.format=Ui,this.type===Hr?(O.map.depthTexture.compareFunction=K?Ta:ba,O.map.depthTexture.minFilter=Bt,O.map.depthTexture.magFilter=Bt):(O.map.depthTexture.compareFunction=null,O.map.depthTexture.minFilter=Lt,O.map.depthTexture.magFilter=Lt);O.camera.updateProjectionMatrix()}O.map.isWebGLCubeRenderTarget!==!0&&(O.map.width!==r.x||O.map.height!==r.y)&&O.map.setSize(r.x,r.y);let re=O.map.isWebGLCubeRenderTarget?6:O.getViewportCount();ne.isPointLight!==!0&&O.updateMatrices(ne,A);let le=(O.camera.layers.mask&4294967294)!==0?O.camera.layers:A.layers;for(let Ue=0;Ue<re;Ue++){let Ze=O.getCamera(Ue);if(ne.isPointLight){let Q=O.camera,_e=O.matrix,Ee=ne.distance||Q.far;Ee!==Q.far&&(Q.far=Ee,Q.updateProjectionMatrix()),Oo.setFromMatrixPosition(ne.matrixWorld),Q.position.copy(Oo),Jc.copy(Q.position),Jc.add(mM[Ue]),Q.up.copy(gM[Ue]),Q.lookAt(Jc),Q.updateMatrixWorld(),_e.makeTranslation(-Oo.x,-Oo.y,-Oo.z),fm.multiplyMatrices(Q.projectionMatrix,Q.matrixWorldInverse),O._frustum.setFromProjectionMatrix(fm,Q.coordinateSystem,Q.reversedDepth)}if(O.map.isWebGLCubeRenderTarget)i.setRenderTarget(O.map,Ue),i.clear();else{Ue===0&&(i.setRenderTarget(O.map),i.clear());let Q=O.getViewport(Ue);o.set(s.x*Q.x,s.y*Q.y,s.x*Q.z,s.y*Q.w),W.viewport(o)}n=O.getFrustum(Ue),R(x,A,Ze,ne,le,this.type)}O.isPointLightShadow!==!0&&this.type===_r&&b(O,A),O.needsUpdate=!1}m=this.type,_.needsUpdate=!1,i.setRenderTarget(V,N,G)};function b(C,x){let A=e.update(S);d.defines.VSM_SAMPLES!==C.blurSamples&&(d.defines.VSM_SAMPLES=C.blurSamples,g.defines.VSM_SAMPLES=C.blurSamples,d.needsUpdate=!0,g.needsUpdate=!0),C.mapPass===null?C.mapPass=new di(r.x,r.y,{format:Vi,type:ti}):(C.mapPass.width!==C.map.width||C.mapPass.height!==C.map.height)&&C.mapPass.setSize(C.map.width,C.map.height),d.uniforms.shadow_pass.value=C.map.depthTexture,d.uniforms.resolution.value.set(C.map.width,C.map.height),d.uniforms.radius.value=C.radius,i.setRenderTarget(C.mapPass),i.clear(),i.renderBufferDirect(x,null,A,d,S,null),g.uniforms.shadow_pass.value=C.mapPass.texture,g.uniforms.resolution.value.set(C.map.width,C.map.height),g.uniforms.radius.value=C.radius,i.setRenderTarget(C.map),i.clear(),i.renderBufferDirect(x,null,A,g,S,null)}function w(C,x,A,V){let N=null,G=A.isPointLight===!0?C.customDistanceMaterial:C.customDepthMaterial;if(G!==void 0)N=G;else if(N=A.isPointLight===!0?l:a,i.localClippingEnabled&&x.clipShadows===!0&&Array.isArray(x.clippingPlanes)&&x.clippingPlanes.length!==0||x.displacementMap&&x.displacementScale!==0||x.alphaMap&&x.alphaTest>0||x.map&&x.alphaTest>0||x.alphaToCoverage===!0){let W=N.uuid,ee=x.uuid,U=c[W];U===void 0&&(U={},c[W]=U);let $=U[ee];$===void 0&&($=N.clone(),U[ee]=$,x.addEventListener("dispose",P)),N=$}if(N.visible=x.visible,N.wireframe=x.wireframe,V===_r?N.side=x.shadowSide!==null?x.shadowSide:x.side:N.side=x.shadowSide!==null?x.shadowSide:h[x.side],N.alphaMap=x.alphaMap,N.alphaTest=x.alphaToCoverage===!0?.5:x.alphaTest,N.map=x.map,N.clipShadows=x.clipShadows,N.clippingPlanes=x.clippingPlanes,N.clipIntersection=x.clipIntersection,N.displacementMap=x.displacementMap,N.displacementScale=x.displacementScale,N.displacementBias=x.displacementBias,N.wireframeLinewidth=x.wireframeLinewidth,N.linewidth=x.linewidth,A.isPointLight===!0&&N.isMeshDistanceMaterial===!0){let W=i.properties.get(N);W.light=A}return N}function R(C,x,A,V,N,G){if(C.visible===!1)return;if(C.layers.test(N)&&(C.isMesh||C.isLine||C.isPoints)&&(C.castShadow||C.receiveShadow&&G===_r)&&(!C.frustumCulled||C.intersectsFrustum(n))){C.modelViewMatrix.multiplyMatrices(A.matrixWorldInverse,C.matrixWorld);let U=e.update(C),$=C.material;if(Array.isArray($)){let ne=U.groups;for(let O=0,ue=ne.length;O<ue;O++){let K=ne[O],re=$[K.materialIndex];if(re&&re.visible){let le=w(C,re,V,G);C.onBeforeShadow(i,C,x,A,U,le,K),i.renderBufferDirect(A,null,U,le,C,K),C.onAfterShadow(i,C,x,A,U,le,K)}}}else if($.visible){let ne=w(C,$,V,G);C.onBeforeShadow(i,C,x,A,U,ne,null),i.renderBufferDirect(A,null,U,ne,C,null),C.onAfterShadow(i,C,x,A,U,ne,null)}}let ee=C.children;for(let U=0,$=ee.length;U<$;U++)R(ee[U],x,A,V,N,G)}function P(C){C.target.removeEventListener("dispose",P);for(let A in c){let V=c[A],N=C.target.uuid;N in V&&(V[N].dispose(),delete V[N])}}}function dm(i,e){function t(){let F=!1,ie=new vt,Z=null,ye=new vt(0,0,0,0);return{setMask:function(de){Z!==de&&!F&&(i.colorMask(de,de,de,de),Z=de)},setLocked:function(de){F=de},setClear:function(de,ge,Ne,nt,fe){fe===!0&&(de*=nt,ge*=nt,Ne*=nt),ie.set(de,ge,Ne,nt),ye.equals(ie)===!1&&(i.clearColor(de,ge,Ne,nt),ye.copy(ie))},reset:function(){F=!1,Z=null,ye.set(-1,0,0,0)}}}function n(){let F=!1,ie=!1,Z=null,ye=null,de=null;return{setReversed:function(ge){if(ie!==ge){let Ne=e.get("EXT_clip_control");ge?Ne.clipControlEXT(Ne.LOWER_LEFT_EXT,Ne.ZERO_TO_ONE_EXT):Ne.clipControlEXT(Ne.LOWER_LEFT_EXT,Ne.NEGATIVE_ONE_TO_ONE_EXT),ie=ge;let nt=de;de=null,this.setClear(nt)}},getReversed:function(){return ie},setTest:function(ge){ge?be(i.DEPTH_TEST):Fe(i.DEPTH_TEST)},setMask:function(ge){Z!==ge&&!F&&(i.depthMask(ge),Z=ge)},setFunc:function(ge){if(ie&&(ge=Mf[ge]),ye!==ge){switch(ge){case Os:i.depthFunc(i.NEVER);break;case Ns:i.depthFunc(i.ALWAYS);break;case Bs:i.depthFunc(i.LESS);break;case Kn:i.depthFunc(i.LEQUAL);break;case Gs:i.depthFunc(i.EQUAL);break;case zs:i.depthFunc(i.GEQUAL);break;case ks:i.depthFunc(i.GREATER);break;case Hs:i.depthFunc(i.NOTEQUAL);break;default:i.depthFunc(i.LEQUAL)}ye=ge}},setLocked:function(ge){F=ge},setClear:function(ge){de!==ge&&(de=ge,ie&&(ge=1-ge),i.clearDepth(ge))},reset:function(){F=!1,Z=null,ye=null,de=null,ie=!1}}}function r(){let F=!1,ie=null,Z=null,ye=null,de=null,ge=null,Ne=null,nt=null,fe=null;return{setTest:function(He){F||(He?be(i.STENCIL_TEST):Fe(i.STENCIL_TEST))},setMask:function(He){ie!==He&&!F&&(i.stencilMask(He),ie=He)},setFunc:function(He,Xe,Te){(Z!==He||ye!==Xe||de!==Te)&&(i.stencilFunc(He,Xe,Te),Z=He,ye=Xe,de=Te)},setOp:function(He,Xe,Te){(ge!==He||Ne!==Xe||nt!==Te)&&(i.stencilOp(He,Xe,Te),ge=He,Ne=Xe,nt=Te)},setLocked:function(He){F=He},setClear:function(He){fe!==He&&(i.clearStencil(He),fe=He)},reset:function(){F=!1,ie=null,Z=null,ye=null,de=null,ge=null,Ne=null,nt=null,fe=null}}}let s=new t,o=new n,a=new r,l={},c=new WeakMap,u={},h={},d={},g=new WeakMap,M=[],S=null,_=!1,m=null,b=null,w=null,R=null,P=null,C=null,x=null,A=new $e(0,0,0),V=0,N=!1,G=null,W=null,ee=null,U=null,$=null,ne=i.getParameter(i.MAX_COMBINED_TEXTURE_IMAGE_UNITS),O=!1,ue=0,K=i.getParameter(i.VERSION);K.indexOf("WebGL")!==-1?(ue=parseFloat(/^WebGL (\d)/.exec(K)[1]),O=ue>=1):K.indexOf("OpenGL ES")!==-1&&(ue=parseFloat(/^OpenGL ES (\d)/.exec(K)[1]),O=ue>=2);let re=null,le={},Ue=i.getParameter(i.SCISSOR_BOX),Ze=i.getParameter(i.VIEWPORT),Q=new vt().fromArray(Ue),_e=new vt().fromArray(Ze);function Ee(F,ie,Z,ye){let de=new Uint8Array(4),ge=i.createTexture();i.bindTexture(F,ge),i.texParameteri(F,i.TEXTURE_MIN_FILTER,i.NEAREST),i.texParameteri(F,i.TEXTURE_MAG_FILTER,i.NEAREST);for(let Ne=0;Ne<Z;Ne++)F===i.TEXTURE_3D||F===i.TEXTURE_2D_ARRAY?i.texImage3D(ie,0,i.RGBA,1,1,ye,0,i.RGBA,i.UNSIGNED_BYTE,de):i.texImage2D(ie+Ne,0,i.RGBA,1,1,0,i.RGBA,i.UNSIGNED_BYTE,de);return ge}let Ge={};Ge[i.TEXTURE_2D]=Ee(i.TEXTURE_2D,i.TEXTURE_2D,1),Ge[i.TEXTURE_CUBE_MAP]=Ee(i.TEXTURE_CUBE_MAP,i.TEXTURE_CUBE_MAP_POSITIVE_X,6),Ge[i.TEXTURE_2D_ARRAY]=Ee(i.TEXTURE_2D_ARRAY,i.TEXTURE_2D_ARRAY,1,1),Ge[i.TEXTURE_3D]=Ee(i.TEXTURE_3D,i.TEXTURE_3D,1,1),s.setClear(0,0,0,1),o.setClear(1),a.setClear(0),be(i.DEPTH_TEST),o.setFunc(Kn),pi(!1),At(rc),be(i.CULL_FACE),zt(yn);function be(F){u[F]!==!0&&(i.enable(F),u[F]=!0)}function Fe(F){u[F]!==!1&&(i.disable(F),u[F]=!1)}function Ye(F,ie){return d[F]!==ie?(i.bindFramebuffer(F,ie),d[F]=ie,F===i.DRAW_FRAMEBUFFER&&(d[i.FRAMEBUFFER]=ie),F===i.FRAMEBUFFER&&(d[i.DRAW_FRAMEBUFFER]=ie),!0):!1}function Ve(F,ie){let Z=M,ye=!1;if(F){Z=g.get(ie),Z===void 0&&(Z=[],g.set(ie,Z));let de=F.textures;if(Z.length!==de.length||Z[0]!==i.COLOR_ATTACHMENT0){for(let ge=0,Ne=de.length;ge<Ne;ge++)Z[ge]=i.COLOR_ATTACHMENT0+ge;Z.length=de.length,ye=!0}}else Z[0]!==i.BACK&&(Z[0]=i.BACK,ye=!0);ye&&i.drawBuffers(Z)}function dt(F){return S!==F?(i.useProgram(F),S=F,!0):!1}let yt={[$n]:i.FUNC_ADD,[Bu]:i.FUNC_SUBTRACT,[Gu]:i.FUNC_REVERSE_SUBTRACT};yt[zu]=i.MIN,yt[ku]=i.MAX;let st={[Hu]:i.ZERO,[Vu]:i.ONE,[Wu]:i.SRC_COLOR,[na]:i.SRC_ALPHA,[Zu]:i.SRC_ALPHA_SATURATE,[$u]:i.DST_COLOR,[qu]:i.DST_ALPHA,[Xu]:i.ONE_MINUS_SRC_COLOR,[ra]:i.ONE_MINUS_SRC_ALPHA,[Ku]:i.ONE_MINUS_DST_COLOR,[Yu]:i.ONE_MINUS_DST_ALPHA,[Ju]:i.CONSTANT_COLOR,[ju]:i.ONE_MINUS_CONSTANT_COLOR,[Qu]:i.CONSTANT_ALPHA,[ef]:i.ONE_MINUS_CONSTANT_ALPHA};function zt(F,ie,Z,ye,de,ge,Ne,nt,fe,He){if(F===yn){_===!0&&(Fe(i.BLEND),_=!1);return}if(_===!1&&(be(i.BLEND),_=!0),F!==Nu){if(F!==m||He!==N){if((b!==$n||P!==$n)&&(i.blendEquation(i.FUNC_ADD),b=$n,P=$n),He)switch(F){case Yn:i.blendFuncSeparate(i.ONE,i.ONE_MINUS_SRC_ALPHA,i.ONE,i.ONE_MINUS_SRC_ALPHA);break;case sc:i.blendFunc(i.ONE,i.ONE);break;case oc:i.blendFuncSeparate(i.ZERO,i.ONE_MINUS_SRC_COLOR,i.ZERO,i.ONE);break;case ac:i.blendFuncSeparate(i.DST_COLOR,i.ONE_MINUS_SRC_ALPHA,i.ZERO,i.ONE);break;default:ot("WebGLState: Invalid blending: ",F);break}else switch(F){case Yn:i.blendFuncSeparate(i.SRC_ALPHA,i.ONE_MINUS_SRC_ALPHA,i.ONE,i.ONE_MINUS_SRC_ALPHA);break;case sc:i.blendFuncSeparate(i.SRC_ALPHA,i.ONE,i.ONE,i.ONE);break;case oc:ot("WebGLState: SubtractiveBlending requires material.premultipliedAlpha = true");break;case ac:ot("WebGLState: MultiplyBlending requires material.premultipliedAlpha = true");break;default:ot("WebGLState: Invalid blending: ",F);break}w=null,R=null,C=null,x=null,A.set(0,0,0),V=0,m=F,N=He}return}de=de||ie,ge=ge||Z,Ne=Ne||ye,(ie!==b||de!==P)&&(i.blendEquationSeparate(yt[ie],yt[de]),b=ie,P=de),(Z!==w||ye!==R||ge!==C||Ne!==x)&&(i.blendFuncSeparate(st[Z],st[ye],st[ge],st[Ne]),w=Z,R=ye,C=ge,x=Ne),(nt.equals(A)===!1||fe!==V)&&(i.blendColor(nt.r,nt.g,nt.b,fe),A.copy(nt),V=fe),m=F,N=!1}function bt(F,ie){F.side===wi?Fe(i.CULL_FACE):be(i.CULL_FACE);let Z=F.side===Ot;ie&&(Z=!Z),pi(Z),F.blending===Yn&&F.transparent===!1?zt(yn):zt(F.blending,F.blendEquation,F.blendSrc,F.blendDst,F.blendEquationAlpha,F.blendSrcAlpha,F.blendDstAlpha,F.blendColor,F.blendAlpha,F.premultipliedAlpha),o.setFunc(F.depthFunc),o.setTest(F.depthTest),o.setMask(F.depthWrite),s.setMask(F.colorWrite);let ye=F.stencilWrite;a.setTest(ye),ye&&(a.setMask(F.stencilWriteMask),a.setFunc(F.stencilFunc,F.stencilRef,F.stencilFuncMask),a.setOp(F.stencilFail,F.stencilZFail,F.stencilZPass)),kt(F.polygonOffset,F.polygonOffsetFactor,F.polygonOffsetUnits),F.alphaToCoverage===!0?be(i.SAMPLE_ALPHA_TO_COVERAGE):Fe(i.SAMPLE_ALPHA_TO_COVERAGE)}function pi(F){G!==F&&(F?i.frontFace(i.CW):i.frontFace(i.CCW),G=F)}function At(F){F!==Uu?(be(i.CULL_FACE),F!==W&&(F===rc?i.cullFace(i.BACK):F===Iu?i.cullFace(i.FRONT):i.cullFace(i.FRONT_AND_BACK))):Fe(i.CULL_FACE),W=F}function Bi(F){F!==ee&&(O&&i.lineWidth(F),ee=F)}function kt(F,ie,Z){F?(be(i.POLYGON_OFFSET_FILL),(U!==ie||$!==Z)&&(U=ie,$=Z,o.getReversed()&&(ie=-ie,Z=-Z),i.polygonOffset(ie,Z))):Fe(i.POLYGON_OFFSET_FILL)}function Ri(F){F?be(i.SCISSOR_TEST):Fe(i.SCISSOR_TEST)}function mi(F){F===void 0&&(F=i.TEXTURE0+ne-1),re!==F&&(i.activeTexture(F),re=F)}function Pi(F,ie,Z){Z===void 0&&(re===null?Z=i.TEXTURE0+ne-1:Z=re);let ye=le[Z];ye===void 0&&(ye={type:void 0,texture:void 0},le[Z]=ye),(ye.type!==F||ye.texture!==ie)&&(re!==Z&&(i.activeTexture(Z),re=Z),i.bindTexture(F,ie||Ge[F]),ye.type=F,ye.texture=ie)}function B(){let F=le[re];F!==void 0&&F.type!==void 0&&(i.bindTexture(F.type,null),F.type=void 0,F.texture=void 0)}function Fi(){try{i.compressedTexImage2D(...arguments)}catch(F){ot("WebGLState:",F)}}function wt(){try{i.compressedTexImage3D(...arguments)}catch(F){ot("WebGLState:",F)}}function Ct(){try{i.texSubImage2D(...arguments)}catch(F){ot("WebGLState:",F)}}function Se(){try{i.texSubImage3D(...arguments)}catch(F){ot("WebGLState:",F)}}function Rt(){try{i.compressedTexSubImage2D(...arguments)}catch(F){ot("WebGLState:",F)}}function Be(){try{i.compressedTexSubImage3D(...arguments)}catch(F){ot("WebGLState:",F)}}function We(){try{i.texStorage2D(...arguments)}catch(F){ot("WebGLState:",F)}}function T(){try{i.texStorage3D(...arguments)}catch(F){ot("WebGLState:",F)}}function y(){try{i.texImage2D(...arguments)}catch(F){ot("WebGLState:",F)}}function k(){try{i.texImage3D(...arguments)}catch(F){ot("WebGLState:",F)}}function oe(F){return h[F]!==void 0?h[F]:i.getParameter(F)}function J(F,ie){h[F]!==ie&&(i.pixelStorei(F,ie),h[F]=ie)}function me(F){Q.equals(F)===!1&&(i.scissor(F.x,F.y,F.z,F.w),Q.copy(F))}function Me(F){_e.equals(F)===!1&&(i.viewport(F.x,F.y,F.z,F.w),_e.copy(F))}function j(F,ie){let Z=c.get(ie);Z===void 0&&(Z=new WeakMap,c.set(ie,Z));let ye=Z.get(F);ye===void 0&&(ye=i.getUniformBlockIndex(ie,F.name),i.uniformBlockBinding(ie,ye,ye),Z.set(F,ye))}function q(F,ie,Z){let de=c.get(ie).get(F);l[de]!==Z&&(i.bindBufferBase(i.UNIFORM_BUFFER,de,Z),l[de]=Z)}function ce(){i.disable(i.BLEND),i.disable(i.CULL_FACE),i.disable(i.DEPTH_TEST),i.disable(i.POLYGON_OFFSET_FILL),i.disable(i.SCISSOR_TEST),i.disable(i.STENCIL_TEST),i.disable(i.SAMPLE_ALPHA_TO_COVERAGE),i.blendEquation(i.FUNC_ADD),i.blendFunc(i.ONE,i.ZERO),i.blendFuncSeparate(i.ONE,i.ZERO,i.ONE,i.ZERO),i.blendColor(0,0,0,0),i.colorMask(!0,!0,!0,!0),i.clearColor(0,0,0,0),i.depthMask(!0),i.depthFunc(i.LESS),o.setReversed(!1),i.clearDepth(1),i.stencilMask(4294967295),i.stencilFunc(i.ALWAYS,0,4294967295),i.stencilOp(i.KEEP,i.KEEP,i.KEEP),i.clearStencil(0),i.cullFace(i.BACK),i.frontFace(i.CCW),i.polygonOffset(0,0),i.activeTexture(i.TEXTURE0),i.bindFramebuffer(i.FRAMEBUFFER,null),i.bindFramebuffer(i.DRAW_FRAMEBUFFER,null),i.bindFramebuffer(i.READ_FRAMEBUFFER,null),i.useProgram(null),i.lineWidth(1),i.scissor(0,0,i.canvas.width,i.canvas.height),i.viewport(0,0,i.canvas.width,i.canvas.height),i.pixelStorei(i.PACK_ALIGNMENT,4),i.pixelStorei(i.UNPACK_ALIGNMENT,4),i.pixelStorei(i.UNPACK_FLIP_Y_WEBGL,!1),i.pixelStorei(i.UNPACK_PREMULTIPLY_ALPHA_WEBGL,!1),i.pixelStorei(i.UNPACK_COLORSPACE_CONVERSION_WEBGL,i.BROWSER_DEFAULT_WEBGL),i.pixelStorei(i.PACK_ROW_LENGTH,0),i.pixelStorei(i.PACK_SKIP_PIXELS,0),i.pixelStorei(i.PACK_SKIP_ROWS,0),i.pixelStorei(i.UNPACK_ROW_LENGTH,0),i.pixelStorei(i.UNPACK_IMAGE_HEIGHT,0),i.pixelStorei(i.UNPACK_SKIP_PIXELS,0),i.pixelStorei(i.UNPACK_SKIP_ROWS,0),i.pixelStorei(i.UNPACK_SKIP_IMAGES,0),u={},h={},re=null,le={},d={},l={},g=new WeakMap,M=[],S=null,_=!1,m=null,b=null,w=null,R=null,P=null,C=null,x=null,A=new $e(0,0,0),V=0,N=!1,G=null,W=null,ee=null,U=null,$=null,Q.set(0,0,i.canvas.width,i.canvas.height),_e.set(0,0,i.canvas.width,i.canvas.height),s.reset(),o.reset(),a.reset()}return{buffers:{color:s,depth:o,stencil:a},enable:be,disable:Fe,bindFramebuffer:Ye,drawBuffers:Ve,useProgram:dt,setBlending:zt,setMaterial:bt,setFlipSided:pi,setCullFace:At,setLineWidth:Bi,setPolygonOffset:kt,setScissorTest:Ri,activeTexture:mi,bindTexture:Pi,unbindTexture:B,compressedTexImage2D:Fi,compressedTexImage3D:wt,texImage2D:y,texImage3D:k,pixelStorei:J,getParameter:oe,updateUBOMapping:j,uniformBlockBinding:q,texStorage2D:We,texStorage3D:T,texSubImage2D:Ct,texSubImage3D:Se,compressedTexSubImage2D:Rt,compressedTexSubImage3D:Be,scissor:me,viewport:Me,reset:ce}}function pm(i,e,t,n,r,s,o){let a=e.has("WEBGL_multisampled_render_to_texture")?e.get("WEBGL_multisampled_render_to_texture"):null,l=typeof navigator>"u"?!1:/OculusBrowser/g.test(navigator.userAgent),c=new Oe,u=new WeakMap,h=new Set,d,g=new WeakMap,M=new Set,S=new FinalizationRegistry(T=>M.delete(T)),_=!1;try{_=typeof OffscreenCanvas<"u"&&new OffscreenCanvas(1,1).getContext("2d")!==null}catch{}function m(T,y){return _?new OffscreenCanvas(T,y):Jn("canvas")}function b(T,y,k){let oe=1,J=We(T);if((J.width>k||J.height>k)&&(oe=k/Math.max(J.width,J.height)),oe<1)if(typeof HTMLImageElement<"u"&&T instanceof HTMLImageElement||typeof HTMLCanvasElement<"u"&&T instanceof HTMLCanvasElement||typeof ImageBitmap<"u"&&T instanceof ImageBitmap||typeof VideoFrame<"u"&&T instanceof VideoFrame){let me=Math.floor(oe*J.width),Me=Math.floor(oe*J.height);d===void 0&&(d=m(me,Me));let j=y?m(me,Me):d;return j.width=me,j.height=Me,j.getContext("2d").drawImage(T,0,0,me,Me),Ce("WebGLRenderer: Texture has been resized from ("+J.width+"x"+J.height+") to ("+me+"x"+Me+")."),j}else return"data"in T&&Ce("WebGLRenderer: Image in DataTexture is too big ("+J.width+"x"+J.height+")."),T;return T}function w(T){return T.generateMipmaps}function R(T){i.generateMipmap(T)}function P(T){return T.isWebGLCubeRenderTarget?i.TEXTURE_CUBE_MAP:T.isWebGL3DRenderTarget?i.TEXTURE_3D:T.isWebGLArrayRenderTarget||T.isCompressedArrayTexture?i.TEXTURE_2D_ARRAY:i.TEXTURE_2D}function C(T,y,k,oe,J,me=!1){if(T!==null){if(i[T]!==void 0)return i[T];Ce("WebGLRenderer: Attempt to use non-existing WebGL internal format '"+T+"'")}let Me;oe&&(Me=e.get("EXT_texture_norm16"),Me||Ce("WebGLRenderer: Unable to use normalized textures without EXT_texture_norm16 extension"));let j=y;if(y===i.RED&&(k===i.FLOAT&&(j=i.R32F),k===i.HALF_FLOAT&&(j=i.R16F),k===i.UNSIGNED_BYTE&&(j=i.R8),k===i.UNSIGNED_SHORT&&Me&&(j=Me.R16_EXT),k===i.SHORT&&Me&&(j=Me.R16_SNORM_EXT)),y===i.RED_INTEGER&&(k===i.UNSIGNED_BYTE&&(j=i.R8UI),k===i.UNSIGNED_SHORT&&(j=i.R16UI),k===i.UNSIGNED_INT&&(j=i.R32UI),k===i.BYTE&&(j=i.R8I),k===i.SHORT&&(j=i.R16I),k===i.INT&&(j=i.R32I)),y===i.RG&&(k===i.FLOAT&&(j=i.RG32F),k===i.HALF_FLOAT&&(j=i.RG16F),k===i.UNSIGNED_BYTE&&(j=i.RG8),k===i.UNSIGNED_SHORT&&Me&&(j=Me.RG16_EXT),k===i.SHORT&&Me&&(j=Me.RG16_SNORM_EXT)),y===i.RG_INTEGER&&(k===i.UNSIGNED_BYTE&&(j=i.RG8UI),k===i.UNSIGNED_SHORT&&(j=i.RG16UI),k===i.UNSIGNED_INT&&(j=i.RG32UI),k===i.BYTE&&(j=i.RG8I),k===i.SHORT&&(j=i.RG16I),k===i.INT&&(j=i.RG32I)),y===i.RGB_INTEGER&&(k===i.UNSIGNED_BYTE&&(j=i.RGB8UI),k===i.UNSIGNED_SHORT&&(j=i.RGB16UI),k===i.UNSIGNED_INT&&(j=i.RGB32UI),k===i.BYTE&&(j=i.RGB8I),k===i.SHORT&&(j=i.RGB16I),k===i.INT&&(j=i.RGB32I)),y===i.RGBA_INTEGER&&(k===i.UNSIGNED_BYTE&&(j=i.RGBA8UI),k===i.UNSIGNED_SHORT&&(j=i.RGBA16UI),k===i.UNSIGNED_INT&&(j=i.RGBA32UI),k===i.BYTE&&(j=i.RGBA8I),k===i.SHORT&&(j=i.RGBA16I),k===i.INT&&(j=i.RGBA32I)),y===i.RGB&&(k===i.UNSIGNED_SHORT&&Me&&(j=Me.RGB16_EXT),k===i.SHORT&&Me&&(j=Me.RGB16_SNORM_EXT),k===i.UNSIGNED_INT_5_9_9_9_REV&&(j=i.RGB9_E5),k===i.UNSIGNED_INT_10F_11F_11F_REV&&(j=i.R11F_G11F_B10F)),y===i.RGBA){let q=me?yr:je.getTransfer(J);k===i.FLOAT&&(j=i.RGBA32F),k===i.HALF_FLOAT&&(j=i.RGBA16F),k===i.UNSIGNED_BYTE&&(j=q===lt?i.SRGB8_ALPHA8:i.RGBA8),k===i.UNSIGNED_SHORT&&Me&&(j=Me.RGBA16_EXT),k===i.SHORT&&Me&&(j=Me.RGBA16_SNORM_EXT),k===i.UNSIGNED_SHORT_4_4_4_4&&(j=i.RGBA4),k===i.UNSIGNED_SHORT_5_5_5_1&&(j=i.RGB5_A1)}return(j===i.R16F||j===i.R32F||j===i.RG16F||j===i.RG32F||j===i.RGBA16F||j===i.RGBA32F)&&e.get("EXT_color_buffer_float"),j}function x(T,y){let k;return T?y===null||y===ei||y===ln?k=i.DEPTH24_STENCIL8:y===fi?k=i.DEPTH32F_STENCIL8:y===In&&(k=i.DEPTH24_STENCIL8,Ce("DepthTexture: 16 bit depth attachment is not supported with stencil. Using 24-bit attachment.")):y===null||y===ei||y===ln?k=i.DEPTH_COMPONENT24:y===fi?k=i.DEPTH_COMPONENT32F:y===In&&(k=i.DEPTH_COMPONENT16),k}function A(T,y){return w(T)===!0||T.isFramebufferTexture&&T.minFilter!==Lt&&T.minFilter!==Bt?Math.log2(Math.max(y.width,y.height))+1:T.mipmaps.length>0?T.mipmaps.length:T.isCompressedTexture&&Array.isArray(T.image)?y.mipmaps.length:1}function V(T){let y=new WeakRef(T);n.get(T).__ref=y,M.add(y),S.register(T,y,y)}function N(T){let y=n.get(T).__ref;y!==void 0&&(M.delete(y),S.unregister(y))}function G(T){ee(T.target)}function W(T){U(T.target)}function ee(T){T.removeEventListener("dispose",G),N(T),ne(T),T.isVideoTexture&&u.delete(T),T.isHTMLTexture&&h.delete(T)}function U(T){T.removeEventListener("dispose",W),N(T),ue(T)}function $(){for(let T of M){let y=T.deref();y!==void 0&&(y.isRenderTarget===!0?U(y):ee(y))}M.clear(),h.clear()}function ne(T){let y=n.get(T);if(y.__webglInit===void 0)return;let k=T.source,oe=g.get(k);if(oe){let J=oe[y.__cacheKey];J.usedTimes--,J.usedTimes===0&&O(T),Object.keys(oe).length===0&&g.delete(k)}n.remove(T)}function O(T){let y=n.get(T);i.deleteTexture(y.__webglTexture);let k=T.source,oe=g.get(k);delete oe[y.__cacheKey],o.memory.textures--}function ue(T){let y=n.get(T);y.__depthDisposeCallback&&y.__depthDisposeCallback();let k=T.depthTexture;if(k&&k.renderTarget===T&&ee(k),T.isWebGLCubeRenderTarget)for(let J=0;J<6;J++){if(Array.isArray(y.__webglFramebuffer[J]))for(let me=0;me<y.__webglFramebuffer[J].length;me++)i.deleteFramebuffer(y.__webglFramebuffer[J][me]);else i.deleteFramebuffer(y.__webglFramebuffer[J]);y.__webglDepthbuffer&&i.deleteRenderbuffer(y.__webglDepthbuffer[J])}else{if(Array.isArray(y.__webglFramebuffer))for(let J=0;J<y.__webglFramebuffer.length;J++)i.deleteFramebuffer(y.__webglFramebuffer[J]);else i.deleteFramebuffer(y.__webglFramebuffer);if(y.__webglDepthbuffer&&i.deleteRenderbuffer(y.__webglDepthbuffer),y.__webglMultisampledFramebuffer&&i.deleteFramebuffer(y.__webglMultisampledFramebuffer),y.__webglColorRenderbuffer)for(let J=0;J<y.__webglColorRenderbuffer.length;J++)y.__webglColorRenderbuffer[J]&&i.deleteRenderbuffer(y.__webglColorRenderbuffer[J]);y.__webglDepthRenderbuffer&&i.deleteRenderbuffer(y.__webglDepthRenderbuffer)}let oe=T.textures;for(let J=0,me=oe.length;J<me;J++){let Me=n.get(oe[J]);Me.__webglTexture&&(i.deleteTexture(Me.__webglTexture),o.memory.textures--),n.remove(oe[J])}n.remove(T)}let K=0;function re(){K=0}function le(){return K}function Ue(T){K=T}function Ze(){let T=K;return T>=r.maxTextures&&Ce("WebGLTextures: Trying to use "+(T+1)+" texture units while this GPU supports only "+r.maxTextures),K+=1,T}function Q(T){let y=[];return y.push(T.wrapS),y.push(T.wrapT),y.push(T.wrapR||0),y.push(T.magFilter),y.push(T.minFilter),y.push(T.anisotropy),y.push(T.internalFormat),y.push(T.format),y.push(T.type),y.push(T.generateMipmaps),y.push(T.mipmapsAutoUpdate),y.push(T.premultiplyAlpha),y.push(T.flipY),y.push(T.unpackAlignment),y.push(T.colorSpace),y.join()}function _e(T,y){let k=n.get(T);if(T.isVideoTexture&&Rt(T),T.isRenderTargetTexture===!1&&T.isExternalTexture!==!0&&T.version>0&&k.__version!==T.version){let oe=T.image;if(oe===null)Ce("WebGLRenderer: Texture marked for update but no image data found.");else if(oe.complete===!1)Ce("WebGLRenderer: Texture marked for update but image is incomplete");else{bt(k,T,y);return}}else T.isExternalTexture&&(k.__webglTexture=T.sourceTexture?T.sourceTexture:null);t.bindTexture(i.TEXTURE_2D,k.__webglTexture,i.TEXTURE0+y)}function Ee(T,y){let k=n.get(T);if(T.isRenderTargetTexture===!1&&T.version>0&&k.__version!==T.version){bt(k,T,y);return}else T.isExternalTexture&&(k.__webglTexture=T.sourceTexture?T.sourceTexture:null);t.bindTexture(i.TEXTURE_2D_ARRAY,k.__webglTexture,i.TEXTURE0+y)}function Ge(T,y){let k=n.get(T);if(T.isRenderTargetTexture===!1&&T.version>0&&k.__version!==T.version){bt(k,T,y);return}t.bindTexture(i.TEXTURE_3D,k.__webglTexture,i.TEXTURE0+y)}function be(T,y){let k=n.get(T);if(T.version>0&&k.__version!==T.version){pi(k,T,y);return}t.bindTexture(i.TEXTURE_CUBE_MAP,k.__webglTexture,i.TEXTURE0+y)}let Fe={[Vs]:i.REPEAT,[Li]:i.CLAMP_TO_EDGE,[Ws]:i.MIRRORED_REPEAT},Ye={[Lt]:i.NEAREST,[rf]:i.NEAREST_MIPMAP_NEAREST,[Xs]:i.NEAREST_MIPMAP_LINEAR,[Bt]:i.LINEAR,[ma]:i.LINEAR_MIPMAP_NEAREST,[ki]:i.LINEAR_MIPMAP_LINEAR},Ve={[lf]:i.NEVER,[Aa]:i.ALWAYS,[cf]:i.LESS,[ba]:i.LEQUAL,[uf]:i.EQUAL,[Ta]:i.GEQUAL,[ff]:i.GREATER,[hf]:i.NOTEQUAL};function dt(T,y){if(y.type===fi&&e.has("OES_texture_float_linear")===!1&&(y.magFilter===Bt||y.magFilter===ma||y.magFilter===Xs||y.magFilter===ki||y.minFilter===Bt||y.minFilter===ma||y.minFilter===Xs||y.minFilter===ki)&&Ce("WebGLRenderer: Unable to use linear filtering with floating point textures. OES_texture_float_linear not supported on this device."),i.texParameteri(T,i.TEXTURE_WRAP_S,Fe[y.wrapS]),i.texParameteri(T,i.TEXTURE_WRAP_T,Fe[y.wrapT]),(T===i.TEXTURE_3D||T===i.TEXTURE_2D_ARRAY)&&i.texParameteri(T,i.TEXTURE_WRAP_R,Fe[y.wrapR]),i.texParameteri(T,i.TEXTURE_MAG_FILTER,Ye[y.magFilter]),i.texParameteri(T,i.TEXTURE_MIN_FILTER,Ye[y.minFilter]),y.compareFunction&&(i.texParameteri(T,i.TEXTURE_COMPARE_MODE,i.COMPARE_REF_TO_TEXTURE),i.texParameteri(T,i.TEXTURE_COMPARE_FUNC,Ve[y.compareFunction])),e.has("EXT_texture_filter_anisotropic")===!0){if(y.magFilter===Lt||y.minFilter!==Xs&&y.minFilter!==ki||y.type===fi&&e.has("OES_texture_float_linear")===!1)return;if(y.anisotropy>1||n.get(y).__currentAnisotropy){let k=e.get("EXT_texture_filter_anisotropic");i.texParameterf(T,k.TEXTURE_MAX_ANISOTROPY_EXT,Math.min(y.anisotropy,r.getMaxAnisotropy())),n.get(y).__currentAnisotropy=y.anisotropy}}}function yt(T,y){let k=!1;T.__webglInit===void 0&&(T.__webglInit=!0,y.addEventListener("dispose",G),V(y));let oe=y.source,J=g.get(oe);J===void 0&&(J={},g.set(oe,J));let me=Q(y);if(me!==T.__cacheKey){J[me]===void 0&&(J[me]={texture:i.createTexture(),usedTimes:0},o.memory.textures++,k=!0),J[me].usedTimes++;let Me=J[T.__cacheKey];Me!==void 0&&(J[T.__cacheKey].usedTimes--,Me.usedTimes===0&&O(y)),T.__cacheKey=me,T.__webglTexture=J[me].texture}return k}function st(T,y,k){return Math.floor(Math.floor(T/k)/y)}function zt(T,y,k,oe){let me=T.updateRanges;if(me.length===0)t.texSubImage2D(i.TEXTURE_2D,0,0,0,y.width,y.height,k,oe,y.data);else{me.sort((F,ie)=>F.start-ie.start);let Me=0;for(let F=1;F<me.length;F++){let ie=me[Me],Z=me[F],ye=ie.start+ie.count,de=st(Z.start,y.width,4),ge=st(ie.start,y.width,4);Z.start<=ye+1&&de===ge&&st(Z.start+Z.count-1,y.width,4)===de?ie.count=Math.max(ie.count,Z.start+Z.count-ie.start):(++Me,me[Me]=Z)}me.length=Me+1;let j=t.getParameter(i.UNPACK_ROW_LENGTH),q=t.getParameter(i.UNPACK_SKIP_PIXELS),ce=t.getParameter(i.UNPACK_SKIP_ROWS);t.pixelStorei(i.UNPACK_ROW_LENGTH,y.width);for(let F=0,ie=me.length;F<ie;F++){let Z=me[F],ye=Math.floor(Z.start/4),de=Math.ceil(Z.count/4),ge=ye%y.width,Ne=Math.floor(ye/y.width),nt=de,fe=1;t.pixelStorei(i.UNPACK_SKIP_PIXELS,ge),t.pixelStorei(i.UNPACK_SKIP_ROWS,Ne),t.texSubImage2D(i.TEXTURE_2D,0,ge,Ne,nt,fe,k,oe,y.data)}T.clearUpdateRanges(),t.pixelStorei(i.UNPACK_ROW_LENGTH,j),t.pixelStorei(i.UNPACK_SKIP_PIXELS,q),t.pixelStorei(i.UNPACK_SKIP_ROWS,ce)}}function bt(T,y,k){let oe=i.TEXTURE_2D;(y.isDataArrayTexture||y.isCompressedArrayTexture)&&(oe=i.TEXTURE_2D_ARRAY),y.isData3DTexture&&(oe=i.TEXTURE_3D);let J=yt(T,y),me=y.source;t.bindTexture(oe,T.__webglTexture,i.TEXTURE0+k);let Me=n.get(me);if(me.version!==Me.__version||J===!0){if(t.activeTexture(i.TEXTURE0+k),(typeof ImageBitmap<"u"&&y.image instanceof ImageBitmap)===!1){let fe=je.getPrimaries(je.workingColorSpace),He=y.colorSpace===ji?null:je.getPrimaries(y.colorSpace),Xe=y.colorSpace===ji||fe===He?i.NONE:i.BROWSER_DEFAULT_WEBGL;t.pixelStorei(i.UNPACK_FLIP_Y_WEBGL,y.flipY),t.pixelStorei(i.UNPACK_PREMULTIPLY_ALPHA_WEBGL,y.premultiplyAlpha),t.pixelStorei(i.UNPACK_COLORSPACE_CONVERSION_WEBGL,Xe)}t.pixelStorei(i.UNPACK_ALIGNMENT,y.unpackAlignment);let q=b(y.image,!1,r.maxTextureSize);q=Be(y,q);let ce=s.convert(y.format,y.colorSpace),F=s.convert(y.type),ie=C(y.internalFormat,ce,F,y.normalized,y.colorSpace,y.isVideoTexture);dt(oe,y);let Z,ye=y.mipmaps,de=y.isVideoTexture!==!0,ge=Me.__version===void 0||J===!0,Ne=me.dataReady,nt=A(y,q);if(y.isDepthTexture)ie=x(y.format===Hi,y.type),ge&&(de?t.texStorage2D(i.TEXTURE_2D,1,ie,q.width,q.height):t.texImage2D(i.TEXTURE_2D,0,ie,q.width,q.height,0,ce,F,null));else if(y.isDataTexture)if(ye.length>0){de&&ge&&t.texStorage2D(i.TEXTURE_2D,nt,ie,ye[0].width,ye[0].height);for(let fe=0,He=ye.length;fe<He;fe++)Z=ye[fe],de?Ne&&t.texSubImage2D(i.TEXTURE_2D,fe,0,0,Z.width,Z.height,ce,F,Z.data):t.texImage2D(i.TEXTURE_2D,fe,ie,Z.width,Z.height,0,ce,F,Z.data);y.generateMipmaps=!1}else de?(ge&&t.texStorage2D(i.TEXTURE_2D,nt,ie,q.width,q.height),Ne&&zt(y,q,ce,F)):t.texImage2D(i.TEXTURE_2D,0,ie,q.width,q.height,0,ce,F,q.data);else if(y.isCompressedTexture)if(y.isCompressedArrayTexture){de&&ge&&t.texStorage3D(i.TEXTURE_2D_ARRAY,nt,ie,ye[0].width,ye[0].height,q.depth);for(let fe=0,He=ye.length;fe<He;fe++)if(Z=ye[fe],y.format!==xi)if(ce!==null)if(de){if(Ne)if(y.layerUpdates.size>0){let Xe=Hc(Z.width,Z.height,y.format,y.type);for(let Te of y.layerUpdates){let gt=Z.data.subarray(Te*Xe/Z.data.BYTES_PER_ELEMENT,(Te+1)*Xe/Z.data.BYTES_PER_ELEMENT);t.compressedTexSubImage3D(i.TEXTURE_2D_ARRAY,fe,0,0,Te,Z.width,Z.height,1,ce,gt)}}else t.compressedTexSubImage3D(i.TEXTURE_2D_ARRAY,fe,0,0,0,Z.width,Z.height,q.depth,ce,Z.data)}else t.compressedTexImage3D(i.TEXTURE_2D_ARRAY,fe,ie,Z.width,Z.height,q.depth,0,Z.data,0,0);else Ce("WebGLRenderer: Attempt to load unsupported compressed texture format in .uploadTexture()");else de?Ne&&t.texSubImage3D(i.TEXTURE_2D_ARRAY,fe,0,0,0,Z.width,Z.height,q.depth,ce,F,Z.data):t.texImage3D(i.TEXTURE_2D_ARRAY,fe,ie,Z.width,Z.height,q.depth,0,ce,F,Z.data);y.layerUpdates.size>0&&y.clearLayerUpdates()}else{de&&ge&&t.texStorage2D(i.TEXTURE_2D,nt,ie,ye[0].width,ye[0].height);for(let fe=0,He=ye.length;fe<He;fe++)Z=ye[fe],y.format!==xi?ce!==null?de?Ne&&t.compressedTexSubImage2D(i.TEXTURE_2D,fe,0,0,Z.width,Z.height,ce,Z.data):t.compressedTexImage2D(i.TEXTURE_2D,fe,ie,Z.width,Z.height,0,Z.data):Ce("WebGLRenderer: Attempt to load unsupported compressed texture format in .uploadTexture()"):de?Ne&&t.texSubImage2D(i.TEXTURE_2D,fe,0,0,Z.width,Z.height,ce,F,Z.data):t.texImage2D(i.TEXTURE_2D,fe,ie,Z.width,Z.height,0,ce,F,Z.data)}else if(y.isDataArrayTexture)if(de){if(ge&&t.texStorage3D(i.TEXTURE_2D_ARRAY,nt,ie,q.width,q.height,q.depth),Ne)if(y.layerUpdates.size>0){let fe=Hc(q.width,q.height,y.format,y.type);for(let He of y.layerUpdates){let Xe=q.data.subarray(He*fe/q.data.BYTES_PER_ELEMENT,(He+1)*fe/q.data.BYTES_PER_ELEMENT);t.texSubImage3D(i.TEXTURE_2D_ARRAY,0,0,0,He,q.width,q.height,1,ce,F,Xe)}y.clearLayerUpdates()}else t.texSubImage3D(i.TEXTURE_2D_ARRAY,0,0,0,0,q.width,q.height,q.depth,ce,F,q.data)}else t.texImage3D(i.TEXTURE_2D_ARRAY,0,ie,q.width,q.height,q.depth,0,ce,F,q.data);else if(y.isData3DTexture)de?(ge&&t.texStorage3D(i.TEXTURE_3D,nt,ie,q.width,q.height,q.depth),Ne&&t.texSubImage3D(i.TEXTURE_3D,0,0,0,0,q.width,q.height,q.depth,ce,F,q.data)):t.texImage3D(i.TEXTURE_3D,0,ie,q.width,q.height,q.depth,0,ce,F,q.data);else if(y.isFramebufferTexture){if(ge)if(de)t.texStorage2D(i.TEXTURE_2D,nt,ie,q.width,q.height);else{let fe=q.width,He=q.height;for(let Xe=0;Xe<nt;Xe++)t.texImage2D(i.TEXTURE_2D,Xe,ie,fe,He,0,ce,F,null),fe>>=1,He>>=1}}else if(y.isHTMLTexture){if("texElementImage2D"in i){let fe=i.canvas;if(fe.hasAttribute("layoutsubtree")||fe.setAttribute("layoutsubtree","true"),q.parentNode!==fe){fe.appendChild(q),h.add(y),fe.onpaint=He=>{let Xe=He.changedElements;for(let Te of h)Xe.includes(Te.image)&&(Te.needsUpdate=!0)},fe.requestPaint();return}if(i.texElementImage2D.length===3)i.texElementImage2D(i.TEXTURE_2D,i.RGBA8,q);else{let Xe=i.RGBA,Te=i.RGBA,gt=i.UNSIGNED_BYTE;i.texElementImage2D(i.TEXTURE_2D,0,Xe,Te,gt,q)}i.texParameteri(i.TEXTURE_2D,i.TEXTURE_MIN_FILTER,i.LINEAR),i.texParameteri(i.TEXTURE_2D,i.TEXTURE_WRAP_S,i.CLAMP_TO_EDGE),i.texParameteri(i.TEXTURE_2D,i.TEXTURE_WRAP_T,i.CLAMP_TO_EDGE)}}else if(ye.length>0){if(de&&ge){let fe=We(ye[0]);t.texStorage2D(i.TEXTURE_2D,nt,ie,fe.width,fe.height)}for(let fe=0,He=ye.length;fe<He;fe++)Z=ye[fe],de?Ne&&t.texSubImage2D(i.TEXTURE_2D,fe,0,0,ce,F,Z):t.texImage2D(i.TEXTURE_2D,fe,ie,ce,F,Z);y.generateMipmaps=!1}else if(de){if(ge){let fe=We(q);t.texStorage2D(i.TEXTURE_2D,nt,ie,fe.width,fe.height)}Ne&&t.texSubImage2D(i.TEXTURE_2D,0,0,0,ce,F,q)}else t.texImage2D(i.TEXTURE_2D,0,ie,ce,F,q);w(y)&&y.mipmapsAutoUpdate===!0&&R(oe),Me.__version=me.version,y.onUpdate&&y.onUpdate(y)}T.__version=y.version}function pi(T,y,k){if(y.image.length!==6)return;let oe=yt(T,y),J=y.source;t.bindTexture(i.TEXTURE_CUBE_MAP,T.__webglTexture,i.TEXTURE0+k);let me=n.get(J);if(J.version!==me.__version||oe===!0){t.activeTexture(i.TEXTURE0+k);let Me=je.getPrimaries(je.workingColorSpace),j=y.colorSpace===ji?null:je.getPrimaries(y.colorSpace),q=y.colorSpace===ji||Me===j?i.NONE:i.BROWSER_DEFAULT_WEBGL;t.pixelStorei(i.UNPACK_FLIP_Y_WEBGL,y.flipY),t.pixelStorei(i.UNPACK_PREMULTIPLY_ALPHA_WEBGL,y.premultiplyAlpha),t.pixelStorei(i.UNPACK_ALIGNMENT,y.unpackAlignment),t.pixelStorei(i.UNPACK_COLORSPACE_CONVERSION_WEBGL,q);let ce=y.isCompressedTexture||y.image[0].isCompressedTexture,F=y.image[0]&&y.image[0].isDataTexture,ie=[];for(let Te=0;Te<6;Te++)!ce&&!F?ie[Te]=b(y.image[Te],!0,r.maxCubemapSize):ie[Te]=F?y.image[Te].image:y.image[Te],ie[Te]=Be(y,ie[Te]);let Z=ie[0],ye=s.convert(y.format,y.colorSpace),de=s.convert(y.type),ge=C(y.internalFormat,ye,de,y.normalized,y.colorSpace),Ne=y.isVideoTexture!==!0,nt=me.__version===void 0||oe===!0,fe=J.dataReady,He=A(y,Z);dt(i.TEXTURE_CUBE_MAP,y);let Xe;if(y.isDepthTexture){if(ge=x(y.format===Hi,y.type),nt)if(Ne)t.texStorage2D(i.TEXTURE_CUBE_MAP,1,ge,Z.width,Z.height);else for(let Te=0;Te<6;Te++)t.texImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,0,ge,Z.width,Z.height,0,ye,de,null)}else if(ce){Ne&&nt&&t.texStorage2D(i.TEXTURE_CUBE_MAP,He,ge,Z.width,Z.height);for(let Te=0;Te<6;Te++){Xe=ie[Te].mipmaps;for(let gt=0;gt<Xe.length;gt++){let Xt=Xe[gt];y.format!==xi?ye!==null?Ne?fe&&t.compressedTexSubImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt,0,0,Xt.width,Xt.height,ye,Xt.data):t.compressedTexImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt,ge,Xt.width,Xt.height,0,Xt.data):Ce("WebGLRenderer: Attempt to load unsupported compressed texture format in .setTextureCube()"):Ne?fe&&t.texSubImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt,0,0,Xt.width,Xt.height,ye,de,Xt.data):t.texImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt,ge,Xt.width,Xt.height,0,ye,de,Xt.data)}}}else{if(Xe=y.mipmaps,Ne&&nt){Xe.length>0&&He++;let Te=We(ie[0]);t.texStorage2D(i.TEXTURE_CUBE_MAP,He,ge,Te.width,Te.height)}for(let Te=0;Te<6;Te++)if(F){Ne?fe&&t.texSubImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,0,0,0,ie[Te].width,ie[Te].height,ye,de,ie[Te].data):t.texImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,0,ge,ie[Te].width,ie[Te].height,0,ye,de,ie[Te].data);for(let gt=0;gt<Xe.length;gt++){let pn=Xe[gt].image[Te].image;Ne?fe&&t.texSubImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt+1,0,0,pn.width,pn.height,ye,de,pn.data):t.texImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt+1,ge,pn.width,pn.height,0,ye,de,pn.data)}}else{Ne?fe&&t.texSubImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,0,0,0,ye,de,ie[Te]):t.texImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,0,ge,ye,de,ie[Te]);for(let gt=0;gt<Xe.length;gt++){let Xt=Xe[gt];Ne?fe&&t.texSubImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt+1,0,0,ye,de,Xt.image[Te]):t.texImage2D(i.TEXTURE_CUBE_MAP_POSITIVE_X+Te,gt+1,ge,ye,de,Xt.image[Te])}}}w(y)&&y.mipmapsAutoUpdate===!0&&R(i.TEXTURE_CUBE_MAP),me.__version=J.version,y.onUpdate&&y.onUpdate(y)}T.__version=y.version}function At(T,y,k,oe,J,me){let Me=s.convert(k.format,k.colorSpace),j=s.convert(k.type),q=C(k.internalFormat,Me,j,k.normalized,k.colorSpace),ce=n.get(y),F=n.get(k);if(F.__renderTarget=y,!ce.__hasExternalTextures){let ie=Math.max(1,y.width>>me),Z=Math.max(1,y.height>>me);J===i.TEXTURE_3D||J===i.TEXTURE_2D_ARRAY?t.texImage3D(J,me,q,ie,Z,y.depth,0,Me,j,null):t.texImage2D(J,me,q,ie,Z,0,Me,j,null)}t.bindFramebuffer(i.FRAMEBUFFER,T),Se(y)?a.framebufferTexture2DMultisampleEXT(i.FRAMEBUFFER,oe,J,F.__webglTexture,0,Ct(y)):(J===i.TEXTURE_2D||J>=i.TEXTURE_CUBE_MAP_POSITIVE_X&&J<=i.TEXTURE_CUBE_MAP_NEGATIVE_Z)&&i.framebufferTexture2D(i.FRAMEBUFFER,oe,J,F.__webglTexture,me),t.bindFramebuffer(i.FRAMEBUFFER,null)}function Bi(T,y,k){if(i.bindRenderbuffer(i.RENDERBUFFER,T),y.depthBuffer){let oe=y.depthTexture,J=oe&&oe.isDepthTexture?oe.type:null,me=x(y.stencilBuffer,J),Me=y.stencilBuffer?i.DEPTH_STENCIL_ATTACHMENT:i.DEPTH_ATTACHMENT;Se(y)?a.renderbufferStorageMultisampleEXT(i.RENDERBUFFER,Ct(y),me,y.width,y.height):k?i.renderbufferStorageMultisample(i.RENDERBUFFER,Ct(y),me,y.width,y.height):i.renderbufferStorage(i.RENDERBUFFER,me,y.width,y.height),i.framebufferRenderbuffer(i.FRAMEBUFFER,Me,i.RENDERBUFFER,T)}else{let oe=y.textures;for(let J=0;J<oe.length;J++){let me=oe[J],Me=s.convert(me.format,me.colorSpace),j=s.convert(me.type),q=C(me.internalFormat,Me,j,me.normalized,me.colorSpace);Se(y)?a.renderbufferStorageMultisampleEXT(i.RENDERBUFFER,Ct(y),q,y.width,y.height):k?i.renderbufferStorageMultisample(i.RENDERBUFFER,Ct(y),q,y.width,y.height):i.renderbufferStorage(i.RENDERBUFFER,q,y.width,y.height)}}i.bindRenderbuffer(i.RENDERBUFFER,null)}function kt(T,y,k){let oe=y.isWebGLCubeRenderTarget===!0;if(t.bindFramebuffer(i.FRAMEBUFFER,T),!(y.depthTexture&&y.depthTexture.isDepthTexture))throw new Error("THREE.WebGLTextures: renderTarget.depthTexture must be an instance of THREE.DepthTexture.");let J=n.get(y.depthTexture);J.__renderTarget=y;let me=oe?y.depthTexture.image[0]:y.depthTexture.image;(!J.__webglTexture||me.width!==y.width||me.height!==y.height)&&(me.width=y.width,me.height=y.height,y.depthTexture.needsUpdate=!0),oe?be(y.depthTexture,0):_e(y.depthTexture,0);let Me=J.__webglTexture,j=Ct(y),q=oe?i.TEXTURE_CUBE_MAP_POSITIVE_X+k:i.TEXTURE_2D,ce=y.depthTexture.format===Hi?i.DEPTH_STENCIL_ATTACHMENT:i.DEPTH_ATTACHMENT;if(y.depthTexture.format===Ui)Se(y)?a.framebufferTexture2DMultisampleEXT(i.FRAMEBUFFER,ce,q,Me,0,j):i.framebufferTexture2D(i.FRAMEBUFFER,ce,q,Me,0);else if(y.depthTexture.format===Hi)Se(y)?a.framebufferTexture2DMultisampleEXT(i.FRAMEBUFFER,ce,q,Me,0,j):i.framebufferTexture2D(i.FRAMEBUFFER,ce,q,Me,0);else throw new Error("THREE.WebGLTextures: Unknown depthTexture format.")}function Ri(T){let y=n.get(T),k=T.isWebGLCubeRenderTarget===!0;if(y.__boundDepthTexture!==T.depthTexture){let oe=T.depthTexture;if(y.__depthDisposeCallback&&y.__depthDisposeCallback(),oe){let J=()=>{delete y.__boundDepthTexture,delete y.__depthDisposeCallback,oe.removeEventListener("dispose",J)};oe.addEventListener("dispose",J),y.__depthDisposeCallback=J}y.__boundDepthTexture=oe}if(T.depthTexture&&!y.__autoAllocateDepthBuffer)if(k)for(let oe=0;oe<6;oe++)kt(y.__webglFramebuffer[oe],T,oe);else T.texture.mipmaps.length>0?kt(y.__webglFramebuffer[0],T,0):kt(y.__webglFramebuffer,T,0);else if(k){y.__webglDepthbuffer=[];for(let oe=0;oe<6;oe++)if(t.bindFramebuffer(i.FRAMEBUFFER,y.__webglFramebuffer[oe]),y.__webglDepthbuffer[oe]===void 0)y.__webglDepthbuffer[oe]=i.createRenderbuffer(),Bi(y.__webglDepthbuffer[oe],T,!1);else{let J=T.stencilBuffer?i.DEPTH_STENCIL_ATTACHMENT:i.DEPTH_ATTACHMENT,me=y.__webglDepthbuffer[oe];i.bindRenderbuffer(i.RENDERBUFFER,me),i.framebufferRenderbuffer(i.FRAMEBUFFER,J,i.RENDERBUFFER,me)}}else if(T.texture.mipmaps.length>0?t.bindFramebuffer(i.FRAMEBUFFER,y.__webglFramebuffer[0]):t.bindFramebuffer(i.FRAMEBUFFER,y.__webglFramebuffer),y.__webglDepthbuffer===void 0)y.__webglDepthbuffer=i.createRenderbuffer(),Bi(y.__webglDepthbuffer,T,!1);else{let J=T.stencilBuffer?i.DEPTH_STENCIL_ATTACHMENT:i.DEPTH_ATTACHMENT,me=y.__webglDepthbuffer;i.bindRenderbuffer(i.RENDERBUFFER,me),i.framebufferRenderbuffer(i.FRAMEBUFFER,J,i.RENDERBUFFER,me)}t.bindFramebuffer(i.FRAMEBUFFER,null)}function mi(T,y,k){let oe=n.get(T);y!==void 0&&At(oe.__webglFramebuffer,T,T.texture,i.COLOR_ATTACHMENT0,i.TEXTURE_2D,0),k!==void 0&&Ri(T)}function Pi(T){let y=T.texture,k=n.get(T),oe=n.get(y);T.addEventListener("dispose",W),V(T);let J=T.textures,me=T.isWebGLCubeRenderTarget===!0,Me=J.length>1;if(Me||(oe.__webglTexture===void 0&&(oe.__webglTexture=i.createTexture()),oe.__version=y.version,o.memory.textures++),me){k.__webglFramebuffer=[];for(let j=0;j<6;j++)if(y.mipmaps.length>0){k.__webglFramebuffer[j]=[];for(let q=0;q<y.mipmaps.length;q++)k.__webglFramebuffer[j][q]=i.createFramebuffer()}else k.__webglFramebuffer[j]=i.createFramebuffer()}else{if(y.mipmaps.length>0){k.__webglFramebuffer=[];for(let j=0;j<y.mipmaps.length;j++)k.__webglFramebuffer[j]=i.createFramebuffer()}else k.__webglFramebuffer=i.createFramebuffer();if(Me)for(let j=0,q=J.length;j<q;j++){let ce=n.get(J[j]);ce.__webglTexture===void 0&&(ce.__webglTexture=i.createTexture(),o.memory.textures++)}if(T.samples>0&&Se(T)===!1){k.__webglMultisampledFramebuffer=i.createFramebuffer(),k.__webglColorRenderbuffer=[],t.bindFramebuffer(i.FRAMEBUFFER,k.__webglMultisampledFramebuffer);for(let j=0;j<J.length;j++){let q=J[j];k.__webglColorRenderbuffer[j]=i.createRenderbuffer(),i.bindRenderbuffer(i.RENDERBUFFER,k.__webglColorRenderbuffer[j]);let ce=s.convert(q.format,q.colorSpace),F=s.convert(q.type),ie=C(q.internalFormat,ce,F,q.normalized,q.colorSpace,T.isXRRenderTarget===!0),Z=Ct(T);i.renderbufferStorageMultisample(i.RENDERBUFFER,Z,ie,T.width,T.height),i.framebufferRenderbuffer(i.FRAMEBUFFER,i.COLOR_ATTACHMENT0+j,i.RENDERBUFFER,k.__webglColorRenderbuffer[j])}i.bindRenderbuffer(i.RENDERBUFFER,null),T.depthBuffer&&(k.__webglDepthRenderbuffer=i.createRenderbuffer(),Bi(k.__webglDepthRenderbuffer,T,!0)),t.bindFramebuffer(i.FRAMEBUFFER,null)}}if(me){t.bindTexture(i.TEXTURE_CUBE_MAP,oe.__webglTexture),dt(i.TEXTURE_CUBE_MAP,y);for(let j=0;j<6;j++)if(y.mipmaps.length>0)for(let q=0;q<y.mipmaps.length;q++)At(k.__webglFramebuffer[j][q],T,y,i.COLOR_ATTACHMENT0,i.TEXTURE_CUBE_MAP_POSITIVE_X+j,q);else At(k.__webglFramebuffer[j],T,y,i.COLOR_ATTACHMENT0,i.TEXTURE_CUBE_MAP_POSITIVE_X+j,0);w(y)?R(i.TEXTURE_CUBE_MAP):y.mipmaps.length>0&&i.texParameteri(i.TEXTURE_CUBE_MAP,i.TEXTURE_MAX_LEVEL,y.mipmaps.length-1),t.unbindTexture()}else if(Me){for(let j=0,q=J.length;j<q;j++){let ce=J[j],F=n.get(ce),ie=i.TEXTURE_2D;(T.isWebGL3DRenderTarget||T.isWebGLArrayRenderTarget)&&(ie=T.isWebGL3DRenderTarget?i.TEXTURE_3D:i.TEXTURE_2D_ARRAY),t.bindTexture(ie,F.__webglTexture),dt(ie,ce),At(k.__webglFramebuffer,T,ce,i.COLOR_ATTACHMENT0+j,ie,0),w(ce)&&R(ie)}t.unbindTexture()}else{let j=i.TEXTURE_2D;if((T.isWebGL3DRenderTarget||T.isWebGLArrayRenderTarget)&&(j=T.isWebGL3DRenderTarget?i.TEXTURE_3D:i.TEXTURE_2D_ARRAY),t.bindTexture(j,oe.__webglTexture),dt(j,y),y.mipmaps.length>0)for(let q=0;q<y.mipmaps.length;q++)At(k.__webglFramebuffer[q],T,y,i.COLOR_ATTACHMENT0,j,q);else At(k.__webglFramebuffer,T,y,i.COLOR_ATTACHMENT0,j,0);w(y)?R(j):y.mipmaps.length>0&&i.texParameteri(j,i.TEXTURE_MAX_LEVEL,y.mipmaps.length-1),t.unbindTexture()}T.depthBuffer&&Ri(T)}function B(T){let y=T.textures;for(let k=0,oe=y.length;k<oe;k++){let J=y[k];if(w(J)&&J.mipmapsAutoUpdate===!0){let me=P(T),Me=n.get(J).__webglTexture;t.bindTexture(me,Me),R(me),t.unbindTexture()}}}let Fi=[];function wt(T){if(T.samples>0){if(Se(T)===!1){let y=T.textures,k=T.width,oe=T.height,J=i.COLOR_BUFFER_BIT,me=T.stencilBuffer?i.DEPTH_STENCIL_ATTACHMENT:i.DEPTH_ATTACHMENT,Me=n.get(T),j=y.length>1;if(j)for(let ce=0;ce<y.length;ce++)t.bindFramebuffer(i.FRAMEBUFFER,Me.__webglMultisampledFramebuffer),i.framebufferRenderbuffer(i.FRAMEBUFFER,i.COLOR_ATTACHMENT0+ce,i.RENDERBUFFER,null),t.bindFramebuffer(i.FRAMEBUFFER,Me.__webglFramebuffer),i.framebufferTexture2D(i.DRAW_FRAMEBUFFER,i.COLOR_ATTACHMENT0+ce,i.TEXTURE_2D,null,0);t.bindFramebuffer(i.READ_FRAMEBUFFER,Me.__webglMultisampledFramebuffer),T.texture.mipmaps.length>0?t.bindFramebuffer(i.DRAW_FRAMEBUFFER,Me.__webglFramebuffer[0]):t.bindFramebuffer(i.DRAW_FRAMEBUFFER,Me.__webglFramebuffer);for(let ce=0;ce<y.length;ce++){if(T.resolveDepthBuffer&&(T.depthBuffer&&(J|=i.DEPTH_BUFFER_BIT),T.stencilBuffer&&T.resolveStencilBuffer&&(J|=i.STENCIL_BUFFER_BIT)),j){i.framebufferRenderbuffer(i.READ_FRAMEBUFFER,i.COLOR_ATTACHMENT0,i.RENDERBUFFER,Me.__webglColorRenderbuffer[ce]);let F=n.get(y[ce]).__webglTexture;i.framebufferTexture2D(i.DRAW_FRAMEBUFFER,i.COLOR_ATTACHMENT0,i.TEXTURE_2D,F,0)}i.blitFramebuffer(0,0,k,oe,0,0,k,oe,J,i.NEAREST),l===!0&&(Fi.length=0,Fi.push(i.COLOR_ATTACHMENT0+ce),T.depthBuffer&&T.storeMultisampledDepthBuffer===!1&&Fi.push(me),i.invalidateFramebuffer(i.READ_FRAMEBUFFER,Fi))}if(t.bindFramebuffer(i.READ_FRAMEBUFFER,null),t.bindFramebuffer(i.DRAW_FRAMEBUFFER,null),j)for(let ce=0;ce<y.length;ce++){t.bindFramebuffer(i.FRAMEBUFFER,Me.__webglMultisampledFramebuffer),i.framebufferRenderbuffer(i.FRAMEBUFFER,i.COLOR_ATTACHMENT0+ce,i.RENDERBUFFER,Me.__webglColorRenderbuffer[ce]);let F=n.get(y[ce]).__webglTexture;t.bindFramebuffer(i.FRAMEBUFFER,Me.__webglFramebuffer),i.framebufferTexture2D(i.DRAW_FRAMEBUFFER,i.COLOR_ATTACHMENT0+ce,i.TEXTURE_2D,F,0)}t.bindFramebuffer(i.DRAW_FRAMEBUFFER,Me.__webglMultisampledFramebuffer)}else if(T.depthBuffer&&T.storeMultisampledDepthBuffer===!1&&l){let y=T.stencilBuffer?i.DEPTH_STENCIL_ATTACHMENT:i.DEPTH_ATTACHMENT;i.invalidateFramebuffer(i.DRAW_FRAMEBUFFER,[y])}}}function Ct(T){return Math.min(r.maxSamples,T.samples)}function Se(T){let y=n.get(T);return T.samples>0&&e.has("WEBGL_multisampled_render_to_texture")===!0&&y.__useRenderToTexture!==!1}function Rt(T){let y=o.render.frame;u.get(T)!==y&&(u.set(T,y),T.update())}function Be(T,y){let k=T.colorSpace,oe=T.format,J=T.type;return T.isCompressedTexture===!0||T.isVideoTexture===!0||k!==On&&k!==ji&&(je.getTransfer(k)===lt?(oe!==xi||J!==Kt)&&Ce("WebGLTextures: sRGB encoded textures have to use RGBAFormat and UnsignedByteType."):ot("WebGLTextures: Unsupported texture color space:",k)),y}function We(T){return typeof HTMLImageElement<"u"&&T instanceof HTMLImageElement?(c.width=T.naturalWidth||T.width,c.height=T.naturalHeight||T.height):typeof VideoFrame<"u"&&T instanceof VideoFrame?(c.width=T.displayWidth,c.height=T.displayHeight):(c.width=T.width,c.height=T.height),c}this.allocateTextureUnit=Ze,this.resetTextureUnits=re,this.getTextureUnits=le,this.setTextureUnits=Ue,this.setTexture2D=_e,this.setTexture2DArray=Ee,this.setTexture3D=Ge,this.setTextureCube=be,this.rebindTextures=mi,this.setupRenderTarget=Pi,this.updateRenderTargetMipmap=B,this.updateMultisampleRenderTarget=wt,this.setupDepthRenderbuffer=Ri,this.setupFrameBufferTexture=At,this.useMultisampledRTT=Se,this.dispose=$}function mm(i,e){function t(n,r=ji){let s,o=je.getTransfer(r);if(n===Kt)return i.UNSIGNED_BYTE;if(n===Wr)return i.UNSIGNED_SHORT_4_4_4_4;if(n===Xr)return i.UNSIGNED_SHORT_5_5_5_1;if(n===xa)return i.UNSIGNED_INT_5_9_9_9_REV;if(n===Ma)return i.UNSIGNED_INT_10F_11F_11F_REV;if(n===ga)return i.BYTE;if(n===_a)return i.SHORT;if(n===In)return i.UNSIGNED_SHORT;if(n===Vr)return i.INT;if(n===ei)return i.UNSIGNED_INT;if(n===fi)return i.FLOAT;if(n===ti)return i.HALF_FLOAT;if(n===ya)return i.ALPHA;if(n===va)return i.RGB;if(n===xi)return i.RGBA;if(n===Ui)return i.DEPTH_COMPONENT;if(n===Hi)return i.DEPTH_STENCIL;if(n===Sa)return i.RED;if(n===qr)return i.RED_INTEGER;if(n===Vi)return i.RG;if(n===Yr)return i.RG_INTEGER;if(n===$r)return i.RGBA_INTEGER;if(n===Kr||n===Zr||n===Jr||n===jr)if(o===lt)if(s=e.get("WEBGL_compressed_texture_s3tc_srgb"),s!==null){if(n===Kr)return s.COMPRESSED_SRGB_S3TC_DXT1_EXT;if(n===Zr)return s.COMPRESSED_SRGB_ALPHA_S3TC_DXT1_EXT;if(n===Jr)return s.COMPRESSED_SRGB_ALPHA_S3TC_DXT3_EXT;if(n===jr)return s.COMPRESSED_SRGB_ALPHA_S3TC_DXT5_EXT}else return null;else if(s=e.get("WEBGL_compressed_texture_s3tc"),s!==null){if(n===Kr)return s.COMPRESSED_RGB_S3TC_DXT1_EXT;if(n===Zr)return s.COMPRESSED_RGBA_S3TC_DXT1_EXT;if(n===Jr)return s.COMPRESSED_RGBA_S3TC_DXT3_EXT;if(n===jr)return s.COMPRESSED_RGBA_S3TC_DXT5_EXT}else return null;if(n===qs||n===Ys||n===$s||n===Ks)if(s=e.get("WEBGL_compressed_texture_pvrtc"),s!==null){if(n===qs)return s.COMPRESSED_RGB_PVRTC_4BPPV1_IMG;if(n===Ys)return s.COMPRESSED_RGB_PVRTC_2BPPV1_IMG;if(n===$s)return s.COMPRESSED_RGBA_PVRTC_4BPPV1_IMG;if(n===Ks)return s.COMPRESSED_RGBA_PVRTC_2BPPV1_IMG}else return null;if(n===Zs||n===Js||n===js||n===Qs||n===eo||n===xr||n===to)if(s=e.get("WEBGL_compressed_texture_etc"),s!==null){if(n===Zs||n===Js)return o===lt?s.COMPRESSED_SRGB8_ETC2:s.COMPRESSED_RGB8_ETC2;if(n===js)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ETC2_EAC:s.COMPRESSED_RGBA8_ETC2_EAC;if(n===Qs)return s.COMPRESSED_R11_EAC;if(n===eo)return s.COMPRESSED_SIGNED_R11_EAC;if(n===xr)return s.COMPRESSED_RG11_EAC;if(n===to)return s.COMPRESSED_SIGNED_RG11_EAC}else return null;if(n===io||n===no||n===ro||n===so||n===oo||n===ao||n===lo||n===co||n===uo||n===fo||n===ho||n===po||n===mo||n===go)if(s=e.get("WEBGL_compressed_texture_astc"),s!==null){if(n===io)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_4x4_KHR:s.COMPRESSED_RGBA_ASTC_4x4_KHR;if(n===no)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_5x4_KHR:s.COMPRESSED_RGBA_ASTC_5x4_KHR;if(n===ro)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_5x5_KHR:s.COMPRESSED_RGBA_ASTC_5x5_KHR;if(n===so)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_6x5_KHR:s.COMPRESSED_RGBA_ASTC_6x5_KHR;if(n===oo)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_6x6_KHR:s.COMPRESSED_RGBA_ASTC_6x6_KHR;if(n===ao)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_8x5_KHR:s.COMPRESSED_RGBA_ASTC_8x5_KHR;if(n===lo)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_8x6_KHR:s.COMPRESSED_RGBA_ASTC_8x6_KHR;if(n===co)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_8x8_KHR:s.COMPRESSED_RGBA_ASTC_8x8_KHR;if(n===uo)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_10x5_KHR:s.COMPRESSED_RGBA_ASTC_10x5_KHR;if(n===fo)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_10x6_KHR:s.COMPRESSED_RGBA_ASTC_10x6_KHR;if(n===ho)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_10x8_KHR:s.COMPRESSED_RGBA_ASTC_10x8_KHR;if(n===po)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_10x10_KHR:s.COMPRESSED_RGBA_ASTC_10x10_KHR;if(n===mo)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_12x10_KHR:s.COMPRESSED_RGBA_ASTC_12x10_KHR;if(n===go)return o===lt?s.COMPRESSED_SRGB8_ALPHA8_ASTC_12x12_KHR:s.COMPRESSED_RGBA_ASTC_12x12_KHR}else return null;if(n===_o||n===xo||n===Mo)if(s=e.get("EXT_texture_compression_bptc"),s!==null){if(n===_o)return o===lt?s.COMPRESSED_SRGB_ALPHA_BPTC_UNORM_EXT:s.COMPRESSED_RGBA_BPTC_UNORM_EXT;if(n===xo)return s.COMPRESSED_RGB_BPTC_SIGNED_FLOAT_EXT;if(n===Mo)return s.COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT_EXT}else return null;if(n===yo||n===vo||n===Mr||n===So)if(s=e.get("EXT_texture_compression_rgtc"),s!==null){if(n===yo)return s.COMPRESSED_RED_RGTC1_EXT;if(n===vo)return s.COMPRESSED_SIGNED_RED_RGTC1_EXT;if(n===Mr)return s.COMPRESSED_RED_GREEN_RGTC2_EXT;if(n===So)return s.COMPRESSED_SIGNED_RED_GREEN_RGTC2_EXT}else return null;return n===ln?i.UNSIGNED_INT_24_8:i[n]!==void 0?i[n]:null}return{convert:t}}var _M=`
void main() {

	gl_Position = vec4( position, 1.0 );

}`,xM=`
uniform sampler2DArray depthColor;
uniform float depthWidth;
uniform float depthHeight;

void main() {

	vec2 coord = vec2( gl_FragCoord.x / depthWidth, gl_FragCoord.y / depthHeight );

	if ( coord.x >= 1.0 ) {

		gl_FragDepth = texture( depthColor, vec3( coord.x - 1.0, coord.y, 1 ) ).r;

	} else {

		gl_FragDepth = texture( depthColor, vec3( coord.x, coord.y, 0 ) ).r;

	}

}`,Ml=class{constructor(){this.texture=null,this.mesh=null,this.depthNear=0,this.depthFar=0}init(e,t){if(this.texture===null){let n=new xs(e.texture);(e.depthNear!==t.depthNear||e.depthFar!==t.depthFar)&&(this.depthNear=e.depthNear,this.depthFar=e.depthFar),this.texture=n}}getMesh(e){if(this.texture!==null&&this.mesh===null){let t=e.cameras[0].viewport,n=new ai({vertexShader:_M,fragmentShader:xM,uniforms:{depthColor:{value:this.texture},depthWidth:{value:t.z},depthHeight:{value:t.w}}});this.mesh=new oi(new Ms(20,20),n)}return this.mesh}reset(){this.texture=null,this.mesh=null}getDepthTexture(){return this.texture}};var yl=class extends ii{constructor(e,t){super();let n=this,r=null,s=1,o=null,a="local-floor",l=1,c=null,u=null,h=null,d=null,g=null,M=null,S=typeof XRWebGLBinding<"u",_=new Ml,m={},b=t.getContextAttributes(),w=null,R=null,P=[],C=[],x=new Oe,A=null,V=null,N=new li;N.viewport=new vt;let G=new li;G.viewport=new vt;let W=[N,G],ee=new hl,U=null,$=null;this.cameraAutoUpdate=!0,this.enabled=!1,this.isPresenting=!1,this.getController=function(Q){let _e=P[Q];return _e===void 0&&(_e=new as,P[Q]=_e),_e.getTargetRaySpace()},this.getControllerGrip=function(Q){let _e=P[Q];return _e===void 0&&(_e=new as,P[Q]=_e),_e.getGripSpace()},this.getHand=function(Q){let _e=P[Q];return _e===void 0&&(_e=new as,P[Q]=_e),_e.getHandSpace()};function ne(Q){let _e=C.indexOf(Q.inputSource);if(_e===-1)return;let Ee=P[_e];Ee!==void 0&&(Ee.update(Q.inputSource,Q.frame,c||o),Ee.dispatchEvent({type:Q.type,data:Q.inputSource}))}function O(){r.removeEventListener("select",ne),r.removeEventListener("selectstart",ne),r.removeEventListener("selectend",ne),r.removeEventListener("squeeze",ne),r.removeEventListener("squeezestart",ne),r.removeEventListener("squeezeend",ne),r.removeEventListener("end",O),r.removeEventListener("inputsourceschange",ue);for(let Q=0;Q<P.length;Q++){let _e=C[Q];_e!==null&&(C[Q]=null,P[Q].disconnect(_e))}U=null,$=null,_.reset();for(let Q in m)delete m[Q];if(e.setRenderTarget(w),g=null,d=null,h=null,r=null,R=null,Ze.stop(),n.isPresenting=!1,e.setPixelRatio(A),e.setSize(x.width,x.height,!1),V!==null){let Q=V.camera;Q.fov=V.fov,Q.zoom=V.zoom,Q.updateProjectionMatrix(),V=null}n.dispatchEvent({type:"sessionend"})}this.setFramebufferScaleFactor=function(Q){s=Q,n.isPresenting===!0&&Ce("WebXRManager: Cannot change framebuffer scale while presenting.")},this.setReferenceSpaceType=function(Q){a=Q,n.isPresenting===!0&&Ce("WebXRManager: Cannot change reference space type while presenting.")},this.getReferenceSpace=function(){return c||o},this.setReferenceSpace=function(Q){c=Q},this.getBaseLayer=function(){return d!==null?d:g},this.getBinding=function(){return h===null&&S&&(h=new XRWebGLBinding(r,t)),h},this.getFrame=function(){return M},this.getSession=function(){return r},this.setSession=async function(Q){if(r=Q,r!==null){if(w=e.getRenderTarget(),r.addEventListener("select",ne),r.addEventListener("selectstart",ne),r.addEventListener("selectend",ne),r.addEventListener("squeeze",ne),r.addEventListener("squeezestart",ne),r.addEventListener("squeezeend",ne),r.addEventListener("end",O),r.addEventListener("inputsourceschange",ue),b.xrCompatible!==!0&&await t.makeXRCompatible(),A=e.getPixelRatio(),e.getSize(x),S&&"createProjectionLayer"in XRWebGLBinding.prototype){let Ee=null,Ge=null,be=null;b.depth&&(be=b.stencil?t.DEPTH24_STENCIL8:t.DEPTH_COMPONENT24,Ee=b.stencil?Hi:Ui,Ge=b.stencil?ln:ei);let Fe={colorFormat:t.RGBA8,depthFormat:be,scaleFactor:s};h=this.getBinding(),d=h.createProjectionLayer(Fe),r.updateRenderState({layers:[d]}),e.setPixelRatio(1),e.setSize(d.textureWidth,d.textureHeight,!1),R=new di(d.textureWidth,d.textureHeight,{format:xi,type:Kt,depthTexture:new Ki(d.textureWidth,d.textureHeight,Ge,void 0,void 0,void 0,void 0,void 0,void 0,Ee),stencilBuffer:b.stencil,colorSpace:e.outputColorSpace,samples:b.antialias?4:0,resolveDepthBuffer:d.ignoreDepthValues===!1,resolveStencilBuffer:d.ignoreDepthValues===!1,storeMultisampledDepthBuffer:d.ignoreDepthValues===!1,storeMultisampledStencilBuffer:d.ignoreDepthValues===!1})}else{let Ee={antialias:b.antialias,alpha:!0,depth:b.depth,stencil:b.stencil,framebufferScaleFactor:s};g=new XRWebGLLayer(r,t,Ee),r.updateRenderState({baseLayer:g}),e.setPixelRatio(1),e.setSize(g.framebufferWidth,g.framebufferHeight,!1),R=new di(g.framebufferWidth,g.framebufferHeight,{format:xi,type:Kt,colorSpace:e.outputColorSpace,stencilBuffer:b.stencil,resolveDepthBuffer:g.ignoreDepthValues===!1,resolveStencilBuffer:g.ignoreDepthValues===!1,storeMultisampledDepthBuffer:g.ignoreDepthValues===!1,storeMultisampledStencilBuffer:g.ignoreDepthValues===!1})}R.isXRRenderTarget=!0,this.setFoveation(l),c=null,o=await r.requestReferenceSpace(a),Ze.setContext(r),Ze.start(),n.isPresenting=!0,n.dispatchEvent({type:"sessionstart"})}},this.getEnvironmentBlendMode=function(){if(r!==null)return r.environmentBlendMode},this.getDepthTexture=function(){return _.getDepthTexture()};function ue(Q){for(let _e=0;_e<Q.removed.length;_e++){let Ee=Q.removed[_e],Ge=C.indexOf(Ee);Ge>=0&&(C[Ge]=null,P[Ge].disconnect(Ee))}for(let _e=0;_e<Q.added.length;_e++){let Ee=Q.added[_e],Ge=C.indexOf(Ee);if(Ge===-1){for(let Fe=0;Fe<P.length;Fe++)if(Fe>=C.length){C.push(Ee),Ge=Fe;break}else if(C[Fe]===null){C[Fe]=Ee,Ge=Fe;break}if(Ge===-1)break}let be=P[Ge];be&&be.connect(Ee)}}function K(Q,_e){_e===null?Q.matrixWorld.copy(Q.matrix):Q.matrixWorld.multiplyMatrices(_e.matrixWorld,Q.matrix),Q.matrixWorldInverse.copy(Q.matrixWorld).invert()}this.updateCamera=function(Q){if(r===null)return;let _e=Q.near,Ee=Q.far;_.texture!==null&&(_.depthNear>0&&(_e=_.depthNear),_.depthFar>0&&(Ee=_.depthFar)),ee.near=G.near=N.near=_e,ee.far=G.far=N.far=Ee,(U!==ee.near||$!==ee.far)&&(r.updateRenderState({depthNear:ee.near,depthFar:ee.far}),U=ee.near,$=ee.far),ee.layers.mask=Q.layers.mask|6,N.layers.mask=ee.layers.mask&-5,G.layers.mask=ee.layers.mask&-3;let Ge=Q.parent,be=ee.cameras;K(ee,Ge);for(let Fe=0;Fe<be.length;Fe++)K(be[Fe],Ge);ee.projectionMatrix.copy(N.projectionMatrix),ee.projectionMatrixInverse.copy(N.projectionMatrixInverse),V===null&&Q.isPerspectiveCamera&&(V={camera:Q,fov:Q.fov,zoom:Q.zoom}),re(Q,ee,Ge)};function re(Q,_e,Ee){Ee===null?Q.matrix.copy(_e.matrixWorld):(Q.matrix.copy(Ee.matrixWorld),Q.matrix.invert(),Q.matrix.multiply(_e.matrixWorld)),Q.matrix.decompose(Q.position,Q.quaternion,Q.scale),Q.updateMatrixWorld(!0),Q.projectionMatrix.copy(_e.projectionMatrix),Q.projectionMatrixInverse.copy(_e.projectionMatrixInverse),Q.isPerspectiveCamera&&(Q.fov=Er*2*Math.atan(1/Q.projectionMatrix.elements[5]),Q.zoom=1)}this.getCamera=function(){return ee},this.getFoveation=function(){if(!(d===null&&g===null))return l},this.setFoveation=function(Q){l=Q,d!==null&&(d.fixedFoveation=Q),g!==null&&g.fixedFoveation!==void 0&&(g.fixedFoveation=Q)},this.hasDepthSensing=function(){return _.texture!==null},this.getDepthSensingMesh=function(){return _.getMesh(ee)},this.getCameraTexture=function(Q){return m[Q]};let le=null;function Ue(Q,_e){if(u=_e.getViewerPose(c||o),M=_e,u!==null){let Ee=u.views;g!==null&&(e.setRenderTargetFramebuffer(R,g.framebuffer),e.setRenderTarget(R));let Ge=!1;Ee.length!==ee.cameras.length&&(ee.cameras.length=0,Ge=!0);for(let Ve=0;Ve<Ee.length;Ve++){let dt=Ee[Ve],yt=null;if(g!==null)yt=g.getViewport(dt);else{let zt=h.getViewSubImage(d,dt);yt=zt.viewport,Ve===0&&(e.setRenderTargetTextures(R,zt.colorTexture,zt.depthStencilTexture),e.setRenderTarget(R))}let st=W[Ve];st===void 0&&(st=new li,st.layers.enable(Ve),st.viewport=new vt,W[Ve]=st),st.matrix.fromArray(dt.transform.matrix),st.matrix.decompose(st.position,st.quaternion,st.scale),st.projectionMatrix.fromArray(dt.projectionMatrix),st.projectionMatrixInverse.copy(st.projectionMatrix).invert(),st.viewport.set(yt.x,yt.y,yt.width,yt.height),Ve===0&&(ee.matrix.copy(st.matrix),ee.matrix.decompose(ee.position,ee.quaternion,ee.scale)),Ge===!0&&ee.cameras.push(st)}let be=r.enabledFeatures;if(be&&be.includes("depth-sensing")&&r.depthUsage=="gpu-optimized"&&S){h=n.getBinding();let Ve=h.getDepthInformation(Ee[0]);Ve&&Ve.isValid&&Ve.texture&&_.init(Ve,r.renderState)}if(be&&be.includes("camera-access")&&S){e.state.unbindTexture(),h=n.getBinding();for(let Ve=0;Ve<Ee.length;Ve++){let dt=Ee[Ve].camera;if(dt){let yt=m[dt];yt||(yt=new xs,m[dt]=yt);let st=h.getCameraImage(dt);yt.sourceTexture=st}}}}for(let Ee=0;Ee<P.length;Ee++){let Ge=C[Ee],be=P[Ee];Ge!==null&&be!==void 0&&be.update(Ge,_e,c||o)}le&&le(Q,_e),_e.detectedPlanes&&n.dispatchEvent({type:"planesdetected",data:_e}),M=null}let Ze=new dl;Ze.setAnimationLoop(Ue),this.setAnimationLoop=function(Q){le=Q},this.dispose=function(){}}};var MM=new tt,gm=new ke;gm.set(-1,0,0,0,1,0,0,0,1);function _m(i,e){function t(_,m){_.matrixAutoUpdate===!0&&_.updateMatrix(),m.value.copy(_.matrix)}function n(_,m){m.color.getRGB(_.fogColor.value,nl(i)),m.isFog?(_.fogNear.value=m.near,_.fogFar.value=m.far):m.isFogExp2&&(_.fogDensity.value=m.density)}function r(_,m,b,w,R){m.isNodeMaterial?m.uniformsNeedUpdate=!1:m.isMeshBasicMaterial?s(_,m):m.isMeshLambertMaterial?(s(_,m),m.envMap&&(_.envMapIntensity.value=m.envMapIntensity)):m.isMeshToonMaterial?(s(_,m),h(_,m)):m.isMeshPhongMaterial?(s(_,m),u(_,m),m.envMap&&(_.envMapIntensity.value=m.envMapIntensity)):m.isMeshStandardMaterial?(s(_,m),d(_,m),m.isMeshPhysicalMaterial&&g(_,m,R)):m.isMeshMatcapMaterial?(s(_,m),M(_,m)):m.isMeshDepthMaterial?s(_,m):m.isMeshDistanceMaterial?(s(_,m),S(_,m)):m.isMeshNormalMaterial?s(_,m):m.isLineBasicMaterial?(o(_,m),m.isLineDashedMaterial&&a(_,m)):m.isPointsMaterial?l(_,m,b,w):m.isSpriteMaterial?c(_,m):m.isShadowMaterial?(_.color.value.copy(m.color),_.opacity.value=m.opacity):m.isShaderMaterial&&(m.uniformsNeedUpdate=!1)}function s(_,m){_.opacity.value=m.opacity,m.color&&_.diffuse.value.copy(m.color),m.emissive&&_.emissive.value.copy(m.emissive).multiplyScalar(m.emissiveIntensity),m.map&&(_.map.value=m.map,t(m.map,_.mapTransform)),m.alphaMap&&(_.alphaMap.value=m.alphaMap,t(m.alphaMap,_.alphaMapTransform)),m.bumpMap&&(_.bumpMap.value=m.bumpMap,t(m.bumpMap,_.bumpMapTransform),_.bumpScale.value=m.bumpScale,m.side===Ot&&(_.bumpScale.value*=-1)),m.normalMap&&(_.normalMap.value=m.normalMap,t(m.normalMap,_.normalMapTransform),_.normalScale.value.copy(m.normalScale),m.side===Ot&&_.normalScale.value.negate()),m.displacementMap&&(_.displacementMap.value=m.displacementMap,t(m.displacementMap,_.displacementMapTransform),_.displacementScale.value=m.displacementScale,_.displacementBias.value=m.displacementBias),m.emissiveMap&&(_.emissiveMap.value=m.emissiveMap,t(m.emissiveMap,_.emissiveMapTransform)),m.specularMap&&(_.specularMap.value=m.specularMap,t(m.specularMap,_.specularMapTransform)),m.alphaTest>0&&(_.alphaTest.value=m.alphaTest);let b=e.get(m),w=b.envMap,R=b.envMapRotation;w&&(_.envMap.value=w,_.envMapRotation.value.setFromMatrix4(MM.makeRotationFromEuler(R)).transpose(),w.isCubeTexture&&w.isRenderTargetTexture===!1&&_.envMapRotation.value.premultiply(gm),_.reflectivity.value=m.reflectivity,_.ior.value=m.ior,_.refractionRatio.value=m.refractionRatio),m.lightMap&&(_.lightMap.value=m.lightMap,_.lightMapIntensity.value=m.lightMapIntensity,t(m.lightMap,_.lightMapTransform)),m.aoMap&&(_.aoMap.value=m.aoMap,_.aoMapIntensity.value=m.aoMapIntensity,t(m.aoMap,_.aoMapTransform))}function o(_,m){_.diffuse.value.copy(m.color),_.opacity.value=m.opacity,m.map&&(_.map.value=m.map,t(m.map,_.mapTransform))}function a(_,m){_.dashSize.value=m.dashSize,_.totalSize.value=m.dashSize+m.gapSize,_.scale.value=m.scale}function l(_,m,b,w){_.diffuse.value.copy(m.color),_.opacity.value=m.opacity,_.size.value=m.size*b,_.scale.value=w*.5,m.map&&(_.map.value=m.map,t(m.map,_.uvTransform)),m.alphaMap&&(_.alphaMap.value=m.alphaMap,t(m.alphaMap,_.alphaMapTransform)),m.alphaTest>0&&(_.alphaTest.value=m.alphaTest)}function c(_,m){_.diffuse.value.copy(m.color),_.opacity.value=m.opacity,_.rotation.value=m.rotation,m.map&&(_.map.value=m.map,t(m.map,_.mapTransform)),m.alphaMap&&(_.alphaMap.value=m.alphaMap,t(m.alphaMap,_.alphaMapTransform)),m.alphaTest>0&&(_.alphaTest.value=m.alphaTest)}function u(_,m){_.specular.value.copy(m.specular),_.shininess.value=Math.max(m.shininess,1e-4)}function h(_,m){m.gradientMap&&(_.gradientMap.value=m.gradientMap)}function d(_,m){_.metalness.value=m.metalness,m.metalnessMap&&(_.metalnessMap.value=m.metalnessMap,t(m.metalnessMap,_.metalnessMapTransform)),_.roughness.value=m.roughness,m.roughnessMap&&(_.roughnessMap.value=m.roughnessMap,t(m.roughnessMap,_.roughnessMapTransform)),m.envMap&&(_.envMapIntensity.value=m.envMapIntensity)}function g(_,m,b){_.ior.value=m.ior,m.diffuseRoughness>0&&(_.diffuseRoughness.value=m.diffuseRoughness,m.diffuseRoughnessMap&&(_.diffuseRoughnessMap.value=m.diffuseRoughnessMap,t(m.diffuseRoughnessMap,_.diffuseRoughnessMapTransform))),m.sheen>0&&(_.sheenColor.value.copy(m.sheenColor).multiplyScalar(m.sheen),_.sheenRoughness.value=m.sheenRoughness,m.sheenColorMap&&(_.sheenColorMap.value=m.sheenColorMap,t(m.sheenColorMap,_.sheenColorMapTransform)),m.sheenRoughnessMap&&(_.sheenRoughnessMap.value=m.sheenRoughnessMap,t(m.sheenRoughnessMap,_.sheenRoughnessMapTransform))),m.clearcoat>0&&(_.clearcoat.value=m.clearcoat,_.clearcoatRoughness.value=m.clearcoatRoughness,m.clearcoatMap&&(_.clearcoatMap.value=m.clearcoatMap,t(m.clearcoatMap,_.clearcoatMapTransform)),m.clearcoatRoughnessMap&&(_.clearcoatRoughnessMap.value=m.clearcoatRoughnessMap,t(m.clearcoatRoughnessMap,_.clearcoatRoughnessMapTransform)),m.clearcoatNormalMap&&(_.clearcoatNormalMap.value=m.clearcoatNormalMap,t(m.clearcoatNormalMap,_.clearcoatNormalMapTransform),_.clearcoatNormalScale.value.copy(m.clearcoatNormalScale),m.side===Ot&&_.clearcoatNormalScale.value.negate())),m.dispersion>0&&(_.dispersion.value=m.dispersion),m.retroreflectivity>0&&(_.retroreflectivity.value=m.retroreflectivity),m.iridescence>0&&(_.iridescence.value=m.iridescence,_.iridescenceIOR.value=m.iridescenceIOR,_.iridescenceThicknessMinimum.value=m.iridescenceThicknessMinimum,_.iridescenceThicknessMaximum.value=m.iridescenceThicknessMaximum,m.iridescenceMap&&(_.iridescenceMap.value=m.iridescenceMap,t(m.iridescenceMap,_.iridescenceMapTransform)),m.iridescenceThicknessMap&&(_.iridescenceThicknessMap.value=m.iridescenceThicknessMap,t(m.iridescenceThicknessMap,_.iridescenceThicknessMapTransform))),m.transmission>0&&(_.transmission.value=m.transmission,_.transmissionSamplerMap.value=b.texture,_.transmissionSamplerSize.value.set(b.width,b.height),m.transmissionMap&&(_.transmissionMap.value=m.transmissionMap,t(m.transmissionMap,_.transmissionMapTransform)),_.thickness.value=m.thickness,m.thicknessMap&&(_.thicknessMap.value=m.thicknessMap,t(m.thicknessMap,_.thicknessMapTransform)),_.attenuationDistance.value=m.attenuationDistance,_.attenuationColor.value.copy(m.attenuationColor)),m.anisotropy>0&&(_.anisotropyVector.value.set(m.anisotropy*Math.cos(m.anisotropyRotation),m.anisotropy*Math.sin(m.anisotropyRotation)),m.anisotropyMap&&(_.anisotropyMap.value=m.anisotropyMap,t(m.anisotropyMap,_.anisotropyMapTransform))),_.specularIntensity.value=m.specularIntensity,_.specularColor.value.copy(m.specularColor),m.specularColorMap&&(_.specularColorMap.value=m.specularColorMap,t(m.specularColorMap,_.specularColorMapTransform)),m.specularIntensityMap&&(_.specularIntensityMap.value=m.specularIntensityMap,t(m.specularIntensityMap,_.specularIntensityMapTransform))}function M(_,m){m.matcap&&(_.matcap.value=m.matcap)}function S(_,m){let b=e.get(m).light;_.referencePosition.value.setFromMatrixPosition(b.matrixWorld),_.nearDistance.value=b.shadow.camera.near,_.farDistance.value=b.shadow.camera.far}return{refreshFogUniforms:n,refreshMaterialUniforms:r}}function xm(i,e,t,n){let r={},s={};function o(b,w){let R=w.program;n.uniformBlockBinding(b,R,r[b.id])}function a(b,w){let R=r[b.id];R===void 0&&(M(b),R=l(b),r[b.id]=R,b.addEventListener("dispose",_));let P=w.program;n.updateUBOMapping(b,P);let C=e.render.frame;s[b.id]!==C&&(c(b),s[b.id]=C)}function l(b){let w=i.createBuffer(),R=b.__size,P=b.usage;return i.bindBuffer(i.UNIFORM_BUFFER,w),i.bufferData(i.UNIFORM_BUFFER,R,P),i.bindBuffer(i.UNIFORM_BUFFER,null),w}function c(b){let w=r[b.id],R=b.uniforms,P=b.__cache;i.bindBuffer(i.UNIFORM_BUFFER,w);for(let C=0,x=R.length;C<x;C++){let A=R[C];if(Array.isArray(A))for(let V=0,N=A.length;V<N;V++)u(A[V],C,V,P);else u(A,C,0,P)}i.bindBuffer(i.UNIFORM_BUFFER,null)}function u(b,w,R,P){if(d(b,w,R,P)===!0){let C=b.__offset,x=b.value;if(Array.isArray(x)){let A=0;for(let V=0;V<x.length;V++){let N=x[V],G=S(N,!0);h(N,b.__data,A),A+=G.storage/Float32Array.BYTES_PER_ELEMENT}}else h(x,b.__data,0);i.bufferSubData(i.UNIFORM_BUFFER,C,b.__data)}}function h(b,w,R){typeof b=="number"||typeof b=="boolean"?w[R]=b:b.isMatrix3?(w[R]=b.elements[0],w[R+1]=b.elements[1],w[R+2]=b.elements[2],w[R+3]=0,w[R+4]=b.elements[3],w[R+5]=b.elements[4],w[R+6]=b.elements[5],w[R+7]=0,w[R+8]=b.elements[6],w[R+9]=b.elements[7],w[R+10]=b.elements[8],w[R+11]=0):ArrayBuffer.isView(b)?w.set(b.subarray(0,w.length-R),R):b.toArray(w,R)}function d(b,w,R,P){let C=b.value,x=w+"_"+R;if(Array.isArray(C)){P[x]===void 0&&(P[x]=[]);let A=P[x],V=!1;for(let N=0;N<C.length;N++)g(C[N],A,N)===!0&&(V=!0);return V}return g(C,P,x)}function g(b,w,R){if(w[R]===void 0)return typeof b=="number"||typeof b=="boolean"?w[R]=b:ArrayBuffer.isView(b)?w[R]=b.slice():w[R]=b.clone(),!0;{let P=w[R];if(typeof b=="number"||typeof b=="boolean"){if(P!==b)return w[R]=b,!0}else{if(ArrayBuffer.isView(b))return!0;if(P.equals(b)===!1)return P.copy(b),!0}}return!1}function M(b){let w=b.uniforms,R=0,P=16;for(let x=0,A=w.length;x<A;x++){let V=Array.isArray(w[x])?w[x]:[w[x]];for(let N=0,G=V.length;N<G;N++){let W=V[N],ee=Array.isArray(W.value)?W.value:[W.value],U=Array.isArray(w[x])||Array.isArray(W.value),$=R;for(let O=0,ue=ee.length;O<ue;O++){let K=ee[O],re=S(K,U),le=R%P,Ue=le%re.boundary,Ze=le+Ue;R+=Ue,Ze!==0&&P-Ze<re.storage&&(R+=P-Ze),O===0&&($=R),R+=re.storage}let ne=W.type==="int"?Int32Array:W.type==="uint"?Uint32Array:Float32Array;W.__data=new ne((R-$)/Float32Array.BYTES_PER_ELEMENT),W.__offset=$}}let C=R%P;return C>0&&(R+=P-C),b.__size=R,b.__cache={},this}function S(b,w){let R={boundary:0,storage:0};return typeof b=="number"||typeof b=="boolean"?(R.boundary=4,R.storage=4):b.isVector2?(R.boundary=8,R.storage=8):b.isVector3||b.isColor?(R.boundary=16,R.storage=12):b.isVector4?(R.boundary=16,R.storage=16):b.isMatrix3?(R.boundary=16,R.storage=48):b.isMatrix4?(R.boundary=16,R.storage=64):b.isTexture?Ce("WebGLRenderer: Texture samplers can not be part of an uniforms group."):ArrayBuffer.isView(b)?(R.boundary=16,R.storage=b.byteLength):Ce("WebGLRenderer: Unsupported uniform value type.",b),w===!0&&(R.boundary=16,R.storage=Math.ceil(R.storage/16)*16),R}function _(b){let w=b.target;w.removeEventListener("dispose",_),i.deleteBuffer(r[w.id]),delete r[w.id],delete s[w.id]}function m(){for(let b in r)i.deleteBuffer(r[b]);r={},s={}}return{bind:o,update:a,dispose:m}}var yM=new Uint16Array([12469,15057,12620,14925,13266,14620,13807,14376,14323,13990,14545,13625,14713,13328,14840,12882,14931,12528,14996,12233,15039,11829,15066,11525,15080,11295,15085,10976,15082,10705,15073,10495,13880,14564,13898,14542,13977,14430,14158,14124,14393,13732,14556,13410,14702,12996,14814,12596,14891,12291,14937,11834,14957,11489,14958,11194,14943,10803,14921,10506,14893,10278,14858,9960,14484,14039,14487,14025,14499,13941,14524,13740,14574,13468,14654,13106,14743,12678,14818,12344,14867,11893,14889,11509,14893,11180,14881,10751,14852,10428,14812,10128,14765,9754,14712,9466,14764,13480,14764,13475,14766,13440,14766,13347,14769,13070,14786,12713,14816,12387,14844,11957,14860,11549,14868,11215,14855,10751,14825,10403,14782,10044,14729,9651,14666,9352,14599,9029,14967,12835,14966,12831,14963,12804,14954,12723,14936,12564,14917,12347,14900,11958,14886,11569,14878,11247,14859,10765,14828,10401,14784,10011,14727,9600,14660,9289,14586,8893,14508,8533,15111,12234,15110,12234,15104,12216,15092,12156,15067,12010,15028,11776,14981,11500,14942,11205,14902,10752,14861,10393,14812,9991,14752,9570,14682,9252,14603,8808,14519,8445,14431,8145,15209,11449,15208,11451,15202,11451,15190,11438,15163,11384,15117,11274,15055,10979,14994,10648,14932,10343,14871,9936,14803,9532,14729,9218,14645,8742,14556,8381,14461,8020,14365,7603,15273,10603,15272,10607,15267,10619,15256,10631,15231,10614,15182,10535,15118,10389,15042,10167,14963,9787,14883,9447,14800,9115,14710,8665,14615,8318,14514,7911,14411,7507,14279,7198,15314,9675,15313,9683,15309,9712,15298,9759,15277,9797,15229,9773,15166,9668,15084,9487,14995,9274,14898,8910,14800,8539,14697,8234,14590,7790,14479,7409,14367,7067,14178,6621,15337,8619,15337,8631,15333,8677,15325,8769,15305,8871,15264,8940,15202,8909,15119,8775,15022,8565,14916,8328,14804,8009,14688,7614,14569,7287,14448,6888,14321,6483,14088,6171,15350,7402,15350,7419,15347,7480,15340,7613,15322,7804,15287,7973,15229,8057,15148,8012,15046,7846,14933,7611,14810,7357,14682,7069,14552,6656,14421,6316,14251,5948,14007,5528,15356,5942,15356,5977,15353,6119,15348,6294,15332,6551,15302,6824,15249,7044,15171,7122,15070,7050,14949,6861,14818,6611,14679,6349,14538,6067,14398,5651,14189,5311,13935,4958,15359,4123,15359,4153,15356,4296,15353,4646,15338,5160,15311,5508,15263,5829,15188,6042,15088,6094,14966,6001,14826,5796,14678,5543,14527,5287,14377,4985,14133,4586,13869,4257,15360,1563,15360,1642,15358,2076,15354,2636,15341,3350,15317,4019,15273,4429,15203,4732,15105,4911,14981,4932,14836,4818,14679,4621,14517,4386,14359,4156,14083,3795,13808,3437,15360,122,15360,137,15358,285,15355,636,15344,1274,15322,2177,15281,2765,15215,3223,15120,3451,14995,3569,14846,3567,14681,3466,14511,3305,14344,3121,14037,2800,13753,2467,15360,0,15360,1,15359,21,15355,89,15346,253,15325,479,15287,796,15225,1148,15133,1492,15008,1749,14856,1882,14685,1886,14506,1783,14324,1608,13996,1398,13702,1183]),bn=null;function Mm(){return bn===null&&(bn=new Cr(yM,16,16,Vi,ti),bn.name="DFG_LUT",bn.minFilter=Bt,bn.magFilter=Bt,bn.wrapS=Li,bn.wrapT=Li,bn.generateMipmaps=!1,bn.needsUpdate=!0),bn}var No=class{constructor(e={}){let{canvas:t=gf(),context:n=null,depth:r=!0,stencil:s=!1,alpha:o=!1,antialias:a=!1,premultipliedAlpha:l=!0,preserveDrawingBuffer:c=!1,powerPreference:u="default",failIfMajorPerformanceCaveat:h=!1,reversedDepthBuffer:d=!1,outputBufferType:g=Kt}=e;this.isWebGLRenderer=!0;let M;if(n!==null){if(typeof WebGLRenderingContext<"u"&&n instanceof WebGLRenderingContext)throw new Error("THREE.WebGLRenderer: WebGL 1 is not supported since r163.");M=n.getContextAttributes().alpha}else M=o;let S=g,_=new Set([$r,Yr,qr]),m=new Set([Kt,ei,In,ln,Wr,Xr]),b=new Uint32Array(4),w=new Int32Array(4),R={textures:[],min:[],max:[],resolution:[]},P=null,C=null,x=[],A=[],V=null;this.domElement=t,this.debug={checkShaderErrors:!0,diagnostics:{keywords:!1},onShaderError:null},this.autoClear=!0,this.autoClearColor=!0,this.autoClearDepth=!0,this.autoClearStencil=!0,this.sortObjects=!0,this.clippingPlanes=[],this.localClippingEnabled=!1,this.toneMapping=zi,this.toneMappingExposure=1,this.transmissionResolutionScale=1;let N=this,G=!1,W=null,ee=null,U=null,$=null;this._outputColorSpace=Ci;let ne=0,O=0,ue=null,K=-1,re=null,le=new vt,Ue=new vt,Ze=null,Q=new $e(0),_e=0,Ee=t.width,Ge=t.height,be=1,Fe=null,Ye=null,Ve=new vt(0,0,Ee,Ge),dt=new vt(0,0,Ee,Ge),yt=!1,st=new tn,zt=new Za,bt=!1,pi=!1,At=new tt,Bi=new I,kt=new vt,Ri={background:null,fog:null,environment:null,overrideMaterial:null,isScene:!0},mi=!1;function Pi(){return ue===null?be:1}let B=n;function Fi(v,L){return t.getContext(v,L)}let wt,Ct,Se,Rt,Be,We,T,y,k,oe,J,me,Me,j,q,ce,F,ie,Z,ye,de,ge,Ne;try{let v={alpha:!0,depth:r,stencil:s,antialias:a,premultipliedAlpha:l,preserveDrawingBuffer:c,powerPreference:u,failIfMajorPerformanceCaveat:h};if("setAttribute"in t&&t.setAttribute("data-engine",`three.js r${"187"}`),t.addEventListener("webglcontextlost",He,!1),t.addEventListener("webglcontextrestored",Xe,!1),t.addEventListener("webglcontextcreationerror",Te,!1),B===null){let L="webgl2";if(B=Fi(L,v),B===null)throw Fi(L)?new Error("THREE.WebGLRenderer: Error creating WebGL context with your selected attributes."):new Error("THREE.WebGLRenderer: Error creating WebGL context.")}nt()}catch(v){throw t.removeEventListener("webglcontextlost",He,!1),t.removeEventListener("webglcontextrestored",Xe,!1),t.removeEventListener("webglcontextcreationerror",Te,!1),ot("WebGLRenderer: "+v.message),v}function nt(){wt=new Cp(B),wt.init(),de=new mm(B,wt),Ct=new yp(B,wt,e,de),Se=new dm(B,wt),Ct.reversedDepthBuffer&&d&&Se.buffers.depth.setReversed(!0),ee=B.createFramebuffer(),U=B.createFramebuffer(),$=B.createFramebuffer(),Rt=new Dp(B),Be=new im,We=new pm(B,wt,Se,Be,Ct,de,Rt),T=new wp(N),y=new eh(B),ge=new xp(B,y),k=new Pp(B,y,Rt,ge),oe=new Up(B,k,y,ge,Rt),ie=new Lp(B,Ct,We),q=new vp(Be),J=new tm(N,T,wt,Ct,ge,q),me=new _m(N,Be),Me=new sm,j=new lm(wt),F=new _p(N,T,Se,oe,M,l),ce=new hm(N,oe,Ct),Ne=new xm(B,Rt,Ct,Se),Z=new Mp(B,wt,Rt),ye=new Fp(B,wt,Rt),Rt.programs=J.programs,N.capabilities=Ct,N.extensions=wt,N.properties=Be,N.renderLists=Me,N.shadowMap=ce,N.state=Se,N.info=Rt}S!==Kt&&(V=new Ip(S,t.width,t.height,a,r,s));let fe=new yl(N,B);this.xr=fe,this.getContext=function(){return B},this.getContextAttributes=function(){return B.getContextAttributes()},this.forceContextLoss=function(){let v=wt.get("WEBGL_lose_context");v&&v.loseContext()},this.forceContextRestore=function(){let v=wt.get("WEBGL_lose_context");v&&v.restoreContext()},this.getPixelRatio=function(){return be},this.setPixelRatio=function(v){v!==void 0&&(be=v,this.setSize(Ee,Ge,!1))},this.getSize=function(v){return v.set(Ee,Ge)},this.setSize=function(v,L,X=!0){if(fe.isPresenting){Ce("WebGLRenderer: Can't change size while VR device is presenting.");return}Ee=v,Ge=L,t.width=Math.floor(v*be),t.height=Math.floor(L*be),X===!0&&(t.style.width=v+"px",t.style.height=L+"px"),V!==null&&V.setSize(t.width,t.height),this.setViewport(0,0,v,L)},this.getDrawingBufferSize=function(v){return v.set(Ee*be,Ge*be).floor()},this.setDrawingBufferSize=function(v,L,X){Ee=v,Ge=L,be=X,t.width=Math.floor(v*X),t.height=Math.floor(L*X),this.setViewport(0,0,v,L)},this.setEffects=function(v){if(S===Kt){ot("WebGLRenderer: setEffects() requires outputBufferType set to HalfFloatType or FloatType.");return}if(v){for(let L=0;L<v.length;L++)if(v[L].isOutputPass===!0){Ce("WebGLRenderer: OutputPass is not needed in setEffects(). Tone mapping and color space conversion are applied automatically.");break}}V.setEffects(v||[])},this.getCurrentViewport=function(v){return v.copy(le)},this.getViewport=function(v){return v.copy(Ve)},this.setViewport=function(v,L,X,z){v.isVector4?Ve.set(v.x,v.y,v.z,v.w):Ve.set(v,L,X,z),Se.viewport(le.copy(Ve).multiplyScalar(Pi()).round())},this.getScissor=function(v){return v.copy(dt)},this.setScissor=function(v,L,X,z){v.isVector4?dt.set(v.x,v.y,v.z,v.w):dt.set(v,L,X,z),Se.scissor(Ue.copy(dt).multiplyScalar(Pi()).round())},this.getScissorTest=function(){return yt},this.setScissorTest=function(v){Se.setScissorTest(yt=v)},this.setOpaqueSort=function(v){Fe=v},this.setTransparentSort=function(v){Ye=v},this.getClearColor=function(v){return v.copy(F.getClearColor())},this.setClearColor=function(){F.setClearColor(...arguments)},this.getClearAlpha=function(){return F.getClearAlpha()},this.setClearAlpha=function(){F.setClearAlpha(...arguments)},this.clear=function(v=!0,L=!0,X=!0){let z=0;if(v){let H=!1;if(ue!==null){let xe=ue.texture.format;H=_.has(xe)}if(H){let xe=ue.texture.type,De=m.has(xe),ve=F.getClearColor(),Re=F.getClearAlpha(),Ie=ve.r,Je=ve.g,at=ve.b;De?(b[0]=Ie,b[1]=Je,b[2]=at,b[3]=Re,B.clearBufferuiv(B.COLOR,0,b)):(w[0]=Ie,w[1]=Je,w[2]=at,w[3]=Re,B.clearBufferiv(B.COLOR,0,w))}else z|=B.COLOR_BUFFER_BIT}L&&(z|=B.DEPTH_BUFFER_BIT,this.state.buffers.depth.setMask(!0)),X&&(z|=B.STENCIL_BUFFER_BIT,this.state.buffers.stencil.setMask(4294967295)),z!==0&&B.clear(z)},this.clearColor=function(){this.clear(!0,!1,!1)},this.clearDepth=function(){this.clear(!1,!0,!1)},this.clearStencil=function(){this.clear(!1,!1,!0)},this.setNodesHandler=function(v){v.setRenderer(this),W=v},this.dispose=function(){t.removeEventListener("webglcontextlost",He,!1),t.removeEventListener("webglcontextrestored",Xe,!1),t.removeEventListener("webglcontextcreationerror",Te,!1),F.dispose(),Me.dispose(),j.dispose(),We.dispose(),Be.dispose(),T.dispose(),oe.dispose(),k.dispose(),ge.dispose(),Ne.dispose(),J.dispose(),fe.dispose(),fe.removeEventListener("sessionstart",Nr),fe.removeEventListener("sessionend",Xo),mn.stop()};function He(v){v.preventDefault(),fc("WebGLRenderer: Context Lost."),G=!0}function Xe(){fc("WebGLRenderer: Context Restored."),G=!1;let v=Rt.autoReset,L=ce.enabled,X=ce.autoUpdate,z=ce.needsUpdate,H=ce.type;nt(),Rt.autoReset=v,ce.enabled=L,ce.autoUpdate=X,ce.needsUpdate=z,ce.type=H}function Te(v){ot("WebGLRenderer: A WebGL context could not be created. Reason: ",v.statusMessage)}function gt(v){let L=v.target;L.removeEventListener("dispose",gt),Xt(L)}function Xt(v){pn(v),Be.remove(v)}function pn(v){let L=Be.get(v).programs;L!==void 0&&(L.forEach(function(X){J.releaseProgram(X)}),v.isShaderMaterial&&J.releaseShaderCache(v))}this.renderBufferDirect=function(v,L,X,z,H,xe){L===null&&(L=Ri);let De=H.isMesh&&H.matrixWorld.determinantAffine()<0,ve=ut(v,L,X,z,H);Se.setMaterial(z,De);let Re=X.index,Ie=1;if(z.wireframe===!0){if(Re=k.getWireframeAttribute(X),Re===void 0)return;Ie=2}let Je=X.drawRange,at=X.attributes.position,Le=Je.start*Ie,rt=(Je.start+Je.count)*Ie;xe!==null&&(Le=Math.max(Le,xe.start*Ie),rt=Math.min(rt,(xe.start+xe.count)*Ie)),Re!==null?(Le=Math.max(Le,0),rt=Math.min(rt,Re.count)):at!=null&&(Le=Math.max(Le,0),rt=Math.min(rt,at.count));let Dt=rt-Le;if(Dt<0||Dt===1/0)return;ge.setup(H,z,ve,X,Re);let pt,St=Z;if(Re!==null&&(pt=y.get(Re),St=ye,St.setIndex(pt)),H.isMesh)z.wireframe===!0?(Se.setLineWidth(z.wireframeLinewidth*Pi()),St.setMode(B.LINES)):St.setMode(B.TRIANGLES);else if(H.isLine){let Qt=z.linewidth;Qt===void 0&&(Qt=1),Se.setLineWidth(Qt*Pi()),H.isLineSegments?St.setMode(B.LINES):H.isLineLoop?St.setMode(B.LINE_LOOP):St.setMode(B.LINE_STRIP)}else H.isPoints?St.setMode(B.POINTS):H.isSprite&&St.setMode(B.TRIANGLES);if(H.isBatchedMesh)if(wt.get("WEBGL_multi_draw"))St.renderMultiDraw(H._multiDrawStarts,H._multiDrawCounts,H._multiDrawCount);else{let Qt=H._multiDrawStarts,Pe=H._multiDrawCounts,ci=H._multiDrawCount,ft=Re?y.get(Re).bytesPerElement:1,Zi=Be.get(z).currentProgram.getUniforms();for(let Yt=0;Yt<ci;Yt++)Zi.setValue(B,"_gl_DrawID",Yt),St.render(Qt[Yt]/ft,Pe[Yt])}else if(H.isInstancedMesh)St.renderInstances(Le,Dt,H.count);else if(X.isInstancedBufferGeometry){let Qt=X._maxInstanceCount!==void 0?X._maxInstanceCount:1/0,Pe=Math.min(X.instanceCount,Qt);St.renderInstances(Le,Dt,Pe)}else St.render(Le,Dt)};function Wo(v,L,X,z){W!==null&&v.isNodeMaterial&&W.setObject(z,v),bt===!0&&q.setState(v,X,!1),v.transparent===!0&&v.side===wi&&v.forceSinglePass===!1?(v.side=Ot,v.needsUpdate=!0,Wn(v,L,z),v.side=Ji,v.needsUpdate=!0,Wn(v,L,z),v.side=wi):Wn(v,L,z)}this.compile=function(v,L,X=null){X===null&&(X=v),W!==null&&W.renderStart(v,L,X),C=j.get(X),C.init(L),A.push(C),X.traverseVisible(function(H){H.isLight&&H.layers.test(L.layers)&&(C.pushLight(H),H.castShadow&&C.pushShadow(H))}),v!==X&&v.traverseVisible(function(H){H.isLight&&H.layers.test(L.layers)&&(C.pushLight(H),H.castShadow&&C.pushShadow(H))}),C.setupLights(),W!==null&&W.updateLights(C.state.lightsArray),pi=this.localClippingEnabled,bt=q.init(this.clippingPlanes,pi),bt===!0&&q.setGlobalState(this.clippingPlanes,L),W!==null&&ce.render(C.state.shadowsArray,X,L);let z=new Set;return v.traverse(function(H){if(!(H.isMesh||H.isPoints||H.isLine||H.isSprite))return;let xe=H.material;if(xe)if(Array.isArray(xe))for(let De=0;De<xe.length;De++){let ve=xe[De];Wo(ve,X,L,H),z.add(ve)}else Wo(xe,X,L,H),z.add(xe)}),C=A.pop(),W!==null&&W.renderEnd(),z},this.compileAsync=function(v,L,X=null){let z=this.compile(v,L,X);return new Promise(H=>{function xe(){if(z.forEach(function(De){let Re=Be.get(De).currentProgram;(Re===void 0||Re.isReady())&&z.delete(De)}),z.size===0){H(v);return}setTimeout(xe,10)}wt.get("KHR_parallel_shader_compile")!==null?xe():setTimeout(xe,10)})};let Ls=null;function Yl(v){Ls&&Ls(v)}function Nr(){mn.stop()}function Xo(){mn.start()}let mn=new dl;mn.setAnimationLoop(Yl),typeof self<"u"&&mn.setContext(self),this.setAnimationLoop=function(v){Ls=v,fe.setAnimationLoop(v),v===null?mn.stop():mn.start()},fe.addEventListener("sessionstart",Nr),fe.addEventListener("sessionend",Xo),this.render=function(v,L){if(L!==void 0&&L.isCamera!==!0){ot("WebGLRenderer.render: camera is not an instance of THREE.Camera.");return}if(G===!0)return;W!==null&&W.renderStart(v,L);let X=fe.enabled===!0&&fe.isPresenting===!0,z=V!==null&&(ue===null||X)&&V.begin(N,ue);if(v.matrixWorldAutoUpdate===!0&&v.updateMatrixWorld(),L.parent===null&&L.matrixWorldAutoUpdate===!0&&L.updateMatrixWorld(),fe.enabled===!0&&fe.isPresenting===!0&&(V===null||V.isCompositing()===!1)&&(fe.cameraAutoUpdate===!0&&fe.updateCamera(L),L=fe.getCamera()),v.isScene===!0&&v.onBeforeRender(N,v,L,ue),C=j.get(v,A.length),C.init(L),C.state.textureUnits=We.getTextureUnits(),A.push(C),At.multiplyMatrices(L.projectionMatrix,L.matrixWorldInverse),L.isArrayCamera?zt.setFromArrayCamera(L):st.setFromProjectionMatrix(At,hi,L.reversedDepth),pi=this.localClippingEnabled,bt=q.init(this.clippingPlanes,pi),P=Me.get(v,x.length),P.init(),x.push(P),this.info.render.frame++,fe.enabled===!0&&fe.isPresenting===!0){let De=N.xr.getDepthSensingMesh();De!==null&&gi(De,L,-1/0,N.sortObjects)}gi(v,L,0,N.sortObjects),P.finish(),W!==null&&W.updateLights(C.state.lightsArray),N.sortObjects===!0&&P.sort(Fe,Ye),mi=fe.enabled===!1||fe.isPresenting===!1||fe.hasDepthSensing()===!1,mi&&F.addToRenderList(P,v),this.info.autoReset===!0&&this.info.reset(),bt===!0&&q.beginShadows();let H=C.state.shadowsArray;if(ce.render(H,v,L),bt===!0&&q.endShadows(),(z&&V.hasRenderPass())===!1){let De=P.opaque,ve=P.transmissive;if(C.setupLights(),L.isArrayCamera){let Re=L.cameras;if(ve.length>0)for(let Ie=0,Je=Re.length;Ie<Je;Ie++){let at=Re[Ie];Pn(De,ve,v,at)}mi&&F.render(v);for(let Ie=0,Je=Re.length;Ie<Je;Ie++){let at=Re[Ie];Cn(P,v,at,at.viewport)}}else ve.length>0&&Pn(De,ve,v,L),mi&&F.render(v),Cn(P,v,L)}ue!==null&&O===0&&(We.updateMultisampleRenderTarget(ue),We.updateRenderTargetMipmap(ue)),z&&V.end(N),v.isScene===!0&&v.onAfterRender(N,v,L),ge.resetDefaultState(),K=-1,re=null,A.pop(),A.length>0?(C=A[A.length-1],We.setTextureUnits(C.state.textureUnits),bt===!0&&q.setGlobalState(N.clippingPlanes,C.state.camera)):C=null,x.pop(),x.length>0?P=x[x.length-1]:P=null,W!==null&&W.renderEnd()};function gi(v,L,X,z){if(v.visible===!1)return;if(v.layers.test(L.layers)){if(v.isGroup)X=v.renderOrder;else if(v.isLOD)v.autoUpdate===!0&&v.update(L);else if(v.isLight)C.pushLight(v),v.castShadow&&C.pushShadow(v);else if(v.isSprite){let De=L.isArrayCamera?zt:st;if(!v.frustumCulled||v.intersectsFrustum(De)){z&&kt.setFromMatrixPosition(v.matrixWorld).applyMatrix4(At);let ve=oe.update(v),Re=v.material;Re.visible&&P.push(v,ve,Re,X,kt.z,null,L)}}else if(v.isMesh||v.isLine||v.isPoints){let De=L.isArrayCamera?zt:st;if(!v.frustumCulled||v.intersectsFrustum(De)){let ve=oe.update(v),Re=v.material;if(z&&(v.boundingSphere!==void 0?(v.boundingSphere===null&&v.computeBoundingSphere(),kt.copy(v.boundingSphere.center)):(ve.boundingSphere===null&&ve.computeBoundingSphere(),kt.copy(ve.boundingSphere.center)),kt.applyMatrix4(v.matrixWorld).applyMatrix4(At)),Array.isArray(Re)){let Ie=ve.groups;for(let Je=0,at=Ie.length;Je<at;Je++){let Le=Ie[Je],rt=Re[Le.materialIndex];rt&&rt.visible&&P.push(v,ve,rt,X,kt.z,Le,L)}}else Re.visible&&P.push(v,ve,Re,X,kt.z,null,L)}}}let xe=v.children;for(let De=0,ve=xe.length;De<ve;De++)gi(xe[De],L,X,z)}function Cn(v,L,X,z){let{opaque:H,transmissive:xe,transparent:De}=v;C.setupLightsView(X),bt===!0&&q.setGlobalState(N.clippingPlanes,X),z&&Se.viewport(le.copy(z)),H.length>0&&Fn(H,L,X),xe.length>0&&Fn(xe,L,X),De.length>0&&Fn(De,L,X),Se.buffers.depth.setTest(!0),Se.buffers.depth.setMask(!0),Se.buffers.color.setMask(!0),Se.setPolygonOffset(!1)}function Pn(v,L,X,z){if((X.isScene===!0?X.overrideMaterial:null)!==null)return;if(C.state.transmissionRenderTarget[z.id]===void 0){let Le=wt.has("EXT_color_buffer_half_float")||wt.has("EXT_color_buffer_float");C.state.transmissionRenderTarget[z.id]=new di(1,1,{generateMipmaps:!0,type:Le?ti:Kt,minFilter:ki,samples:Math.max(4,Ct.samples),stencilBuffer:s,resolveDepthBuffer:!1,resolveStencilBuffer:!1,storeMultisampledDepthBuffer:!1,storeMultisampledStencilBuffer:!1,colorSpace:je.workingColorSpace})}let xe=C.state.transmissionRenderTarget[z.id],De=z.viewport||le;xe.setSize(De.z*N.transmissionResolutionScale,De.w*N.transmissionResolutionScale);let ve=N.getRenderTarget(),Re=N.getActiveCubeFace(),Ie=N.getActiveMipmapLevel();N.setRenderTarget(xe),N.getClearColor(Q),_e=N.getClearAlpha(),_e<1&&N.setClearColor(16777215,.5),N.clear(),mi&&F.render(X);let Je=N.toneMapping;N.toneMapping=zi;let at=z.viewport;if(z.viewport!==void 0&&(z.viewport=void 0),C.setupLightsView(z),bt===!0&&q.setGlobalState(N.clippingPlanes,z),Fn(v,X,z),We.updateMultisampleRenderTarget(xe),We.updateRenderTargetMipmap(xe),wt.has("WEBGL_multisampled_render_to_texture")===!1){let Le=!1;for(let rt=0,Dt=L.length;rt<Dt;rt++){let pt=L[rt],{object:St,geometry:Qt,material:Pe,group:ci}=pt;if(Pe.side===wi&&St.layers.test(z.layers)){let ft=Pe.side;Pe.side=Ot,Pe.needsUpdate=!0,qo(St,X,z,Qt,Pe,ci),Pe.side=ft,Pe.needsUpdate=!0,Le=!0}}Le===!0&&(We.updateMultisampleRenderTarget(xe),We.updateRenderTargetMipmap(xe))}N.setRenderTarget(ve,Re,Ie),N.setClearColor(Q,_e),at!==void 0&&(z.viewport=at),N.toneMapping=Je}function Fn(v,L,X){let z=L.isScene===!0?L.overrideMaterial:null;for(let H=0,xe=v.length;H<xe;H++){let De=v[H],{object:ve,geometry:Re,group:Ie}=De,Je=De.material;Je.allowOverride===!0&&z!==null&&(Je=z),ve.layers.test(X.layers)&&qo(ve,L,X,Re,Je,Ie)}}function qo(v,L,X,z,H,xe){W!==null&&H.isNodeMaterial&&W.setObject(v,H),v.onBeforeRender(N,L,X,z,H,xe),v.modelViewMatrix.multiplyMatrices(X.matrixWorldInverse,v.matrixWorld),v.normalMatrix.getNormalMatrix(v.modelViewMatrix),H.onBeforeRender(N,L,X,z,v,xe),H.transparent===!0&&H.side===wi&&H.forceSinglePass===!1?(H.side=Ot,H.needsUpdate=!0,N.renderBufferDirect(X,L,z,H,v,xe),H.side=Ji,H.needsUpdate=!0,N.renderBufferDirect(X,L,z,H,v,xe),H.side=wi):N.renderBufferDirect(X,L,z,H,v,xe),v.onAfterRender(N,L,X,z,H,xe)}function Yo(v){let L=0;for(let X of v)X.texture!==null&&L++;return L}function Wn(v,L,X){L.isScene!==!0&&(L=Ri);let z=Be.get(v),H=C.state.lights,xe=C.state.shadowsArray,De=H.state.version,ve=J.getParameters(v,H.state,xe,L,X,C.state.lightProbeGridArray),Re=J.getProgramCacheKey(ve),Ie=z.programs;z.environment=v.isMeshStandardMaterial||v.isMeshLambertMaterial||v.isMeshPhongMaterial?L.environment:null,z.fog=L.fog;let Je=v.isMeshStandardMaterial||v.isMeshLambertMaterial&&!v.envMap||v.isMeshPhongMaterial&&!v.envMap;z.envMap=T.get(v.envMap||z.environment,Je),z.envMapRotation=z.environment!==null&&v.envMap===null?L.environmentRotation:v.envMapRotation,Ie===void 0&&(v.addEventListener("dispose",gt),Ie=new Map,z.programs=Ie,z.programVariants=new Map);let at=Ie.get(Re);if(at!==void 0){if(z.currentProgram===at&&z.lightsStateVersion===De)return Dn(v,ve),at}else ve.uniforms=J.getUniforms(v),W!==null&&v.isNodeMaterial&&W.build(v,X,ve),v.onBeforeCompile(ve,N),at=J.acquireProgram(ve,Re),Ie.set(Re,at),z.uniforms=ve.uniforms;let Le=z.uniforms;return(!v.isShaderMaterial&&!v.isRawShaderMaterial||v.clipping===!0)&&(Le.clippingPlanes=q.uniform),Dn(v,ve),z.needsLights=Gr(v),z.lightsStateVersion=De,z.needsLights&&(Le.ambientLightColor.value=H.state.ambient,Le.lightProbe.value=H.state.probe,Le.sunLights.value=H.state.sun,Le.sunLightShadows.value=H.state.sunShadow,Le.directionalLights.value=H.state.directional,Le.directionalLightShadows.value=H.state.directionalShadow,Le.spotLights.value=H.state.spot,Le.spotLightShadows.value=H.state.spotShadow,Le.rectAreaLights.value=H.state.rectArea,Le.ltc_1.value=H.state.rectAreaLTC1,Le.ltc_2.value=H.state.rectAreaLTC2,Le.pointLights.value=H.state.point,Le.pointLightShadows.value=H.state.pointShadow,Le.hemisphereLights.value=H.state.hemi,Le.sunShadowMatrix.value=H.state.sunShadowMatrix,Le.sunShadowCascade.value=H.state.sunShadowCascade,Le.directionalShadowMatrix.value=H.state.directionalShadowMatrix,Le.spotLightMatrix.value=H.state.spotLightMatrix,Le.spotLightMap.value=H.state.spotLightMap,Le.pointShadowMatrix.value=H.state.pointShadowMatrix),z.numLightProbeGrids=Yo(C.state.lightProbeGridArray),z.currentProgram=at,z.uniformsList=null,at}function $o(v,L,X,z,H){let xe=Be.get(v),De=xe.currentProgram.id+","+z+","+H,ve=xe.programVariants.get(De);return ve===void 0?(ve=Wn(v,L,X),xe.programVariants.set(De,ve)):(xe.currentProgram=ve,xe.uniformsList=null,xe.outputColorSpace=z,xe.toneMapping=H),ve}function Br(v){if(v.uniformsList===null){let L=v.currentProgram.getUniforms();v.uniformsList=lr.seqWithValue(L.seq,v.uniforms)}return v.uniformsList}function Dn(v,L){let X=Be.get(v);X.outputColorSpace=L.outputColorSpace,X.batching=L.batching,X.batchingColor=L.batchingColor,X.instancing=L.instancing,X.instancingColor=L.instancingColor,X.instancingMorph=L.instancingMorph,X.skinning=L.skinning,X.morphTargets=L.morphTargets,X.morphNormals=L.morphNormals,X.morphColors=L.morphColors,X.morphTargetsCount=L.morphTargetsCount,X.numClippingPlanes=L.numClippingPlanes,X.numIntersection=L.numClipIntersection,X.vertexAlphas=L.vertexAlphas,X.vertexTangents=L.vertexTangents,X.toneMapping=L.toneMapping}function ut(v,L,X,z,H){L.isScene!==!0&&(L=Ri),We.resetTextureUnits();let xe=L.fog,De=z.isMeshStandardMaterial||z.isMeshLambertMaterial||z.isMeshPhongMaterial?L.environment:null,ve=ue===null?N.outputColorSpace:ue.isXRRenderTarget===!0?ue.texture.colorSpace:je.workingColorSpace,Re=z.isMeshStandardMaterial||z.isMeshLambertMaterial&&!z.envMap||z.isMeshPhongMaterial&&!z.envMap,Ie=T.get(z.envMap||De,Re),Je=z.vertexColors===!0&&!!X.attributes.color&&X.attributes.color.itemSize===4,at=!!X.attributes.tangent&&(!!z.normalMap||z.anisotropy>0),Le=!!X.morphAttributes.position,rt=!!X.morphAttributes.normal,Dt=!!X.morphAttributes.color,pt=zi;z.toneMapped&&(ue===null||ue.isXRRenderTarget===!0)&&(pt=N.toneMapping);let St=X.morphAttributes.position||X.morphAttributes.normal||X.morphAttributes.color,Qt=St!==void 0?St.length:0,Pe=Be.get(z),ci=C.state.lights;if(bt===!0&&(pi===!0||v!==re)){let mt=v===re&&z.id===K;q.setState(z,v,mt)}let ft=!1,Zi=!1;z.version===Pe.__version?Pe.needsLights&&Pe.lightsStateVersion!==ci.state.version||H.isBatchedMesh&&Pe.batching===!1||!H.isBatchedMesh&&Pe.batching===!0||H.isBatchedMesh&&Pe.batchingColor===!0&&H._colorsTexture===null||H.isBatchedMesh&&Pe.batchingColor===!1&&H._colorsTexture!==null||H.isInstancedMesh&&Pe.instancing===!1||!H.isInstancedMesh&&Pe.instancing===!0||H.isSkinnedMesh&&Pe.skinning===!1||!H.isSkinnedMesh&&Pe.skinning===!0||H.isInstancedMesh&&Pe.instancingColor===!0&&H.instanceColor===null||H.isInstancedMesh&&Pe.instancingColor===!1&&H.instanceColor!==null||H.isInstancedMesh&&Pe.instancingMorph===!0&&H.morphTexture===null||H.isInstancedMesh&&Pe.instancingMorph===!1&&H.morphTexture!==null||Pe.envMap!==Ie||z.fog===!0&&Pe.fog!==xe||Pe.numClippingPlanes!==void 0&&(Pe.numClippingPlanes!==q.numPlanes||Pe.numIntersection!==q.numIntersection)||Pe.vertexAlphas!==Je||Pe.vertexTangents!==at||Pe.morphTargets!==Le||Pe.morphNormals!==rt||Pe.morphColors!==Dt||Pe.morphTargetsCount!==Qt||Pe.numLightProbeGrids!==Yo(C.state.lightProbeGridArray)?ft=!0:(Pe.outputColorSpace!==ve||Pe.toneMapping!==pt)&&(Zi=!0):(ft=!0,Pe.__version=z.version);let Yt=Pe.currentProgram;(ft===!0||Zi===!0)&&(Yt=Zi===!0?$o(z,L,H,ve,pt):Wn(z,L,H),W&&z.isNodeMaterial&&W.onUpdateProgram(z,Yt,Pe));let gn=!1,_n=!1,Ln=!1,ct=Yt.getUniforms(),$t=Pe.uniforms;if(Se.useProgram(Yt.program)&&(gn=!0,_n=!0,Ln=!0),z.id!==K&&(K=z.id,_n=!0),gn||re!==v){Se.buffers.depth.getReversed()&&v.reversedDepth!==!0&&(v._reversedDepth=!0,v.updateProjectionMatrix()),ct.setValue(B,"projectionMatrix",v.projectionMatrix),ct.setValue(B,"viewMatrix",v.matrixWorldInverse);let Ht=ct.map.cameraPosition;Ht!==void 0&&Ht.setValue(B,Bi.setFromMatrixPosition(v.matrixWorld)),Ct.logarithmicDepthBuffer&&ct.setValue(B,"logDepthBufFC",2/(Math.log(v.far+1)/Math.LN2)),(z.isMeshPhongMaterial||z.isMeshToonMaterial||z.isMeshLambertMaterial||z.isMeshBasicMaterial||z.isMeshStandardMaterial||z.isShaderMaterial)&&ct.setValue(B,"isOrthographic",v.isOrthographicCamera===!0),re!==v&&(re=v,_n=!0,Ln=!0)}if(Pe.needsLights&&(ci.state.sunShadowMap.length>0&&ct.setValue(B,"sunShadowMap",ci.state.sunShadowMap,We),ci.state.directionalShadowMap.length>0&&ct.setValue(B,"directionalShadowMap",ci.state.directionalShadowMap,We),ci.state.spotShadowMap.length>0&&ct.setValue(B,"spotShadowMap",ci.state.spotShadowMap,We),ci.state.pointShadowMap.length>0&&ct.setValue(B,"pointShadowMap",ci.state.pointShadowMap,We)),H.isSkinnedMesh){ct.setOptional(B,H,"bindMatrix"),ct.setOptional(B,H,"bindMatrixInverse");let mt=H.skeleton;mt&&(mt.boneTexture===null&&mt.computeBoneTexture(),ct.setValue(B,"boneTexture",mt.boneTexture,We))}H.isBatchedMesh&&(ct.setOptional(B,H,"batchingTexture"),ct.setValue(B,"batchingTexture",H._matricesTexture,We),ct.setOptional(B,H,"batchingIdTexture"),ct.setValue(B,"batchingIdTexture",H._indirectTexture,We),ct.setOptional(B,H,"batchingColorTexture"),H._colorsTexture!==null&&ct.setValue(B,"batchingColorTexture",H._colorsTexture,We));let Gi=X.morphAttributes;if((Gi.position!==void 0||Gi.normal!==void 0||Gi.color!==void 0)&&ie.update(H,X,Yt),(_n||Pe.receiveShadow!==H.receiveShadow)&&(Pe.receiveShadow=H.receiveShadow,ct.setValue(B,"receiveShadow",H.receiveShadow)),(z.isMeshStandardMaterial||z.isMeshLambertMaterial||z.isMeshPhongMaterial)&&z.envMap===null&&L.environment!==null&&($t.envMapIntensity.value=L.environmentIntensity),$t.dfgLUT!==void 0&&($t.dfgLUT.value=Mm()),_n){if(ct.setValue(B,"toneMappingExposure",N.toneMappingExposure),Pe.needsLights&&Ko($t,Ln),xe&&z.fog===!0&&me.refreshFogUniforms($t,xe),me.refreshMaterialUniforms($t,z,be,Ge,C.state.transmissionRenderTarget[v.id]),Pe.needsLights&&Pe.numLightProbeGrids>0){let mt=R,Ht=0;for(let an of C.state.lightProbeGridArray)an.texture!==null&&(mt.textures[Ht]=an.texture,mt.min[Ht]=an.boundingBox.min,mt.max[Ht]=an.boundingBox.max,mt.resolution[Ht]=an.resolution,Ht++);for(let an in mt)mt[an].length=Ht;$t.probesSH.value=mt.textures,$t.probesMin.value=mt.min,$t.probesMax.value=mt.max,$t.probesResolution.value=mt.resolution}lr.upload(B,Br(Pe),$t,We)}if(z.isShaderMaterial&&z.uniformsNeedUpdate===!0&&(lr.upload(B,Br(Pe),$t,We),z.uniformsNeedUpdate=!1),z.isSpriteMaterial&&ct.setValue(B,"center",H.center),ct.setValue(B,"modelViewMatrix",H.modelViewMatrix),ct.setValue(B,"normalMatrix",H.normalMatrix),ct.setValue(B,"modelMatrix",H.matrixWorld),z.uniformsGroups!==void 0){let mt=z.uniformsGroups;for(let Ht=0,an=mt.length;Ht<an;Ht++){let Zo=mt[Ht];Ne.update(Zo,Yt),Ne.bind(Zo,Yt)}}return Yt}function Ko(v,L){v.ambientLightColor.needsUpdate=L,v.lightProbe.needsUpdate=L,v.sunLights.needsUpdate=L,v.sunLightShadows.needsUpdate=L,v.directionalLights.needsUpdate=L,v.directionalLightShadows.needsUpdate=L,v.pointLights.needsUpdate=L,v.pointLightShadows.needsUpdate=L,v.spotLights.needsUpdate=L,v.spotLightShadows.needsUpdate=L,v.rectAreaLights.needsUpdate=L,v.hemisphereLights.needsUpdate=L}function Gr(v){return v.isMeshLambertMaterial||v.isMeshToonMaterial||v.isMeshPhongMaterial||v.isMeshStandardMaterial||v.isShadowMaterial||v.isShaderMaterial&&v.lights===!0}this.getActiveCubeFace=function(){return ne},this.getActiveMipmapLevel=function(){return O},this.getRenderTarget=function(){return ue},this.setRenderTargetTextures=function(v,L,X){let z=Be.get(v);z.__autoAllocateDepthBuffer=v.resolveDepthBuffer===!1,z.__autoAllocateDepthBuffer===!1&&(z.__useRenderToTexture=!1),Be.get(v.texture).__webglTexture=L,Be.get(v.depthTexture).__webglTexture=z.__autoAllocateDepthBuffer?void 0:X,z.__hasExternalTextures=!0},this.setRenderTargetFramebuffer=function(v,L){let X=Be.get(v);X.__webglFramebuffer=L,X.__useDefaultFramebuffer=L===void 0},this.setRenderTarget=function(v,L=0,X=0){ue=v,ne=L,O=X;let z=null,H=!1,xe=!1;if(v){let ve=Be.get(v);if(ve.__useDefaultFramebuffer!==void 0){Se.bindFramebuffer(B.FRAMEBUFFER,ve.__webglFramebuffer),le.copy(v.viewport),Ue.copy(v.scissor),Ze=v.scissorTest,Se.viewport(le),Se.scissor(Ue),Se.setScissorTest(Ze),K=-1;return}else if(ve.__webglFramebuffer===void 0)We.setupRenderTarget(v);else if(ve.__hasExternalTextures)We.rebindTextures(v,Be.get(v.texture).__webglTexture,Be.get(v.depthTexture).__webglTexture);else if(v.depthBuffer){let Je=v.depthTexture;if(ve.__boundDepthTexture!==Je){if(Je!==null&&Be.has(Je)&&(v.width!==Je.image.width||v.height!==Je.image.height))throw new Error("THREE.WebGLRenderer: Attached DepthTexture is initialized to the incorrect size.");We.setupDepthRenderbuffer(v)}}let Re=v.texture;(Re.isData3DTexture||Re.isDataArrayTexture||Re.isCompressedArrayTexture)&&(xe=!0);let Ie=Be.get(v).__webglFramebuffer;v.isWebGLCubeRenderTarget?(Array.isArray(Ie[L])?z=Ie[L][X]:z=Ie[L],H=!0):v.samples>0&&We.useMultisampledRTT(v)===!1?z=Be.get(v).__webglMultisampledFramebuffer:Array.isArray(Ie)?z=Ie[X]:z=Ie,le.copy(v.viewport),Ue.copy(v.scissor),Ze=v.scissorTest}else le.copy(Ve).multiplyScalar(be).floor(),Ue.copy(dt).multiplyScalar(be).floor(),Ze=yt;if(X!==0&&(z=ee),Se.bindFramebuffer(B.FRAMEBUFFER,z)&&Se.drawBuffers(v,z),Se.viewport(le),Se.scissor(Ue),Se.setScissorTest(Ze),H){let ve=Be.get(v.texture);B.framebufferTexture2D(B.FRAMEBUFFER,B.COLOR_ATTACHMENT0,B.TEXTURE_CUBE_MAP_POSITIVE_X+L,ve.__webglTexture,X)}else if(xe){let ve=L;for(let Re=0;Re<v.textures.length;Re++){let Ie=Be.get(v.textures[Re]);B.framebufferTextureLayer(B.FRAMEBUFFER,B.COLOR_ATTACHMENT0+Re,Ie.__webglTexture,X,ve)}}else if(v!==null&&X!==0){let ve=Be.get(v.texture);B.framebufferTexture2D(B.FRAMEBUFFER,B.COLOR_ATTACHMENT0,B.TEXTURE_2D,ve.__webglTexture,X)}K=-1};function Xn(v){let L=Be.get(v);return(L.__readFormat!==v.format||L.__readType!==v.type)&&(L.__readFormat=v.format,L.__readType=v.type,L.__formatReadable=Ct.textureFormatReadable(v.format),L.__typeReadable=Ct.textureTypeReadable(v.type)),L}this.readRenderTargetPixels=function(v,L,X,z,H,xe,De,ve=0){if(!(v&&v.isWebGLRenderTarget)){ot("WebGLRenderer.readRenderTargetPixels: renderTarget is not THREE.WebGLRenderTarget.");return}let Re=Be.get(v).__webglFramebuffer;if(v.isWebGLCubeRenderTarget&&De!==void 0&&(Re=Re[De],Array.isArray(Re)&&(Re=Re[0])),Re){Se.bindFramebuffer(B.FRAMEBUFFER,Re);try{let Ie=v.textures[ve],Je=Ie.format,at=Ie.type;v.textures.length>1&&B.readBuffer(B.COLOR_ATTACHMENT0+ve);let Le=Xn(Ie);if(Le.__formatReadable===!1){ot("WebGLRenderer.readRenderTargetPixels: renderTarget is not in RGBA or implementation defined format.");return}if(Le.__typeReadable===!1){ot("WebGLRenderer.readRenderTargetPixels: renderTarget is not in UnsignedByteType or implementation defined type.");return}L>=0&&L<=v.width-z&&X>=0&&X<=v.height-H&&B.readPixels(L,X,z,H,de.convert(Je),de.convert(at),xe)}finally{let Ie=ue!==null?Be.get(ue).__webglFramebuffer:null;Se.bindFramebuffer(B.FRAMEBUFFER,Ie)}}},this.readRenderTargetPixelsAsync=async function(v,L,X,z,H,xe,De,ve=0){if(!(v&&v.isWebGLRenderTarget))throw new Error("THREE.WebGLRenderer.readRenderTargetPixels: renderTarget is not THREE.WebGLRenderTarget.");let Re=Be.get(v).__webglFramebuffer;if(v.isWebGLCubeRenderTarget&&De!==void 0&&(Re=Re[De],Array.isArray(Re)&&(Re=Re[0])),Re)if(L>=0&&L<=v.width-z&&X>=0&&X<=v.height-H){Se.bindFramebuffer(B.FRAMEBUFFER,Re);let Ie=v.textures[ve],Je=Ie.format,at=Ie.type;v.textures.length>1&&B.readBuffer(B.COLOR_ATTACHMENT0+ve);let Le=Xn(Ie);if(Le.__formatReadable===!1)throw new Error("THREE.WebGLRenderer.readRenderTargetPixelsAsync: renderTarget is not in RGBA or implementation defined format.");if(Le.__typeReadable===!1)throw new Error("THREE.WebGLRenderer.readRenderTargetPixelsAsync: renderTarget is not in UnsignedByteType or implementation defined type.");let rt=B.createBuffer();B.bindBuffer(B.PIXEL_PACK_BUFFER,rt),B.bufferData(B.PIXEL_PACK_BUFFER,xe.byteLength,B.STREAM_READ),B.readPixels(L,X,z,H,de.convert(Je),de.convert(at),0),B.bindBuffer(B.PIXEL_PACK_BUFFER,null);let Dt=ue!==null?Be.get(ue).__webglFramebuffer:null;Se.bindFramebuffer(B.FRAMEBUFFER,Dt);let pt=B.fenceSync(B.SYNC_GPU_COMMANDS_COMPLETE,0);return B.flush(),await xf(B,pt,4),B.bindBuffer(B.PIXEL_PACK_BUFFER,rt),B.getBufferSubData(B.PIXEL_PACK_BUFFER,0,xe),B.bindBuffer(B.PIXEL_PACK_BUFFER,null),B.deleteBuffer(rt),B.deleteSync(pt),xe}else throw new Error("THREE.WebGLRenderer.readRenderTargetPixelsAsync: requested read bounds are out of range.")},this.copyFramebufferToTexture=function(v,L=null,X=0){let z=Math.pow(2,-X),H=Math.floor(v.image.width*z),xe=Math.floor(v.image.height*z),De=L!==null?L.x:0,ve=L!==null?L.y:0;We.setTexture2D(v,0),B.copyTexSubImage2D(B.TEXTURE_2D,X,0,0,De,ve,H,xe),Se.unbindTexture()},this.copyTextureToTexture=function(v,L,X=null,z=null,H=0,xe=0){let De,ve,Re,Ie,Je,at,Le,rt,Dt,pt=v.isCompressedTexture?v.mipmaps[xe]:v.image;if(X!==null)De=X.max.x-X.min.x,ve=X.max.y-X.min.y,Re=X.isBox3?X.max.z-X.min.z:1,Ie=X.min.x,Je=X.min.y,at=X.isBox3?X.min.z:0;else{let ct=Math.pow(2,-H);De=Math.floor(pt.width*ct),ve=Math.floor(pt.height*ct),v.isDataArrayTexture?Re=pt.depth:v.isData3DTexture?Re=Math.floor(pt.depth*ct):Re=1,Ie=0,Je=0,at=0}z!==null?(Le=z.x,rt=z.y,Dt=z.z):(Le=0,rt=0,Dt=0);let St=de.convert(L.format),Qt=de.convert(L.type),Pe;L.isData3DTexture?(We.setTexture3D(L,0),Pe=B.TEXTURE_3D):L.isDataArrayTexture||L.isCompressedArrayTexture?(We.setTexture2DArray(L,0),Pe=B.TEXTURE_2D_ARRAY):(We.setTexture2D(L,0),Pe=B.TEXTURE_2D),Se.activeTexture(B.TEXTURE0),Se.pixelStorei(B.UNPACK_FLIP_Y_WEBGL,L.flipY),Se.pixelStorei(B.UNPACK_PREMULTIPLY_ALPHA_WEBGL,L.premultiplyAlpha),Se.pixelStorei(B.UNPACK_ALIGNMENT,L.unpackAlignment);let ci=Se.getParameter(B.UNPACK_ROW_LENGTH),ft=Se.getParameter(B.UNPACK_IMAGE_HEIGHT),Zi=Se.getParameter(B.UNPACK_SKIP_PIXELS),Yt=Se.getParameter(B.UNPACK_SKIP_ROWS),gn=Se.getParameter(B.UNPACK_SKIP_IMAGES);Se.pixelStorei(B.UNPACK_ROW_LENGTH,pt.width),Se.pixelStorei(B.UNPACK_IMAGE_HEIGHT,pt.height),Se.pixelStorei(B.UNPACK_SKIP_PIXELS,Ie),Se.pixelStorei(B.UNPACK_SKIP_ROWS,Je),Se.pixelStorei(B.UNPACK_SKIP_IMAGES,at);let _n=v.isDataArrayTexture||v.isData3DTexture,Ln=L.isDataArrayTexture||L.isData3DTexture;if(v.isDepthTexture){let ct=Be.get(v),$t=Be.get(L),Gi=Be.get(ct.__renderTarget),mt=Be.get($t.__renderTarget);Se.bindFramebuffer(B.READ_FRAMEBUFFER,Gi.__webglFramebuffer),Se.bindFramebuffer(B.DRAW_FRAMEBUFFER,mt.__webglFramebuffer);for(let Ht=0;Ht<Re;Ht++)_n&&(B.framebufferTextureLayer(B.READ_FRAMEBUFFER,B.COLOR_ATTACHMENT0,Be.get(v).__webglTexture,H,at+Ht),B.framebufferTextureLayer(B.DRAW_FRAMEBUFFER,B.COLOR_ATTACHMENT0,Be.get(L).__webglTexture,xe,Dt+Ht)),B.blitFramebuffer(Ie,Je,Ie+De,Je+ve,Le,rt,Le+De,rt+ve,B.DEPTH_BUFFER_BIT,B.NEAREST);Se.bindFramebuffer(B.READ_FRAMEBUFFER,null),Se.bindFramebuffer(B.DRAW_FRAMEBUFFER,null)}else if(H!==0||v.isRenderTargetTexture||Be.has(v)){let ct=Be.get(v),$t=Be.get(L);Se.bindFramebuffer(B.READ_FRAMEBUFFER,U),Se.bindFramebuffer(B.DRAW_FRAMEBUFFER,$);for(let Gi=0;Gi<Re;Gi++)_n?B.framebufferTextureLayer(B.READ_FRAMEBUFFER,B.COLOR_ATTACHMENT0,ct.__webglTexture,H,at+Gi):B.framebufferTexture2D(B.READ_FRAMEBUFFER,B.COLOR_ATTACHMENT0,B.TEXTURE_2D,ct.__webglTexture,H),Ln?B.framebufferTextureLayer(B.DRAW_FRAMEBUFFER,B.COLOR_ATTACHMENT0,$t.__webglTexture,xe,Dt+Gi):B.framebufferTexture2D(B.DRAW_FRAMEBUFFER,B.COLOR_ATTACHMENT0,B.TEXTURE_2D,$t.__webglTexture,xe),H!==0?B.blitFramebuffer(Ie,Je,Ie+De,Je+ve,Le,rt,Le+De,rt+ve,B.COLOR_BUFFER_BIT,B.NEAREST):Ln?B.copyTexSubImage3D(Pe,xe,Le,rt,Dt+Gi,Ie,Je,De,ve):B.copyTexSubImage2D(Pe,xe,Le,rt,Ie,Je,De,ve);Se.bindFramebuffer(B.READ_FRAMEBUFFER,null),Se.bindFramebuffer(B.DRAW_FRAMEBUFFER,null)}else Ln?v.isDataTexture||v.isData3DTexture?B.texSubImage3D(Pe,xe,Le,rt,Dt,De,ve,Re,St,Qt,pt.data):L.isCompressedArrayTexture?B.compressedTexSubImage3D(Pe,xe,Le,rt,Dt,De,ve,Re,St,pt.data):B.texSubImage3D(Pe,xe,Le,rt,Dt,De,ve,Re,St,Qt,pt):v.isDataTexture?B.texSubImage2D(B.TEXTURE_2D,xe,Le,rt,De,ve,St,Qt,pt.data):v.isCompressedTexture?B.compressedTexSubImage2D(B.TEXTURE_2D,xe,Le,rt,pt.width,pt.height,St,pt.data):B.texSubImage2D(B.TEXTURE_2D,xe,Le,rt,De,ve,St,Qt,pt);Se.pixelStorei(B.UNPACK_ROW_LENGTH,ci),Se.pixelStorei(B.UNPACK_IMAGE_HEIGHT,ft),Se.pixelStorei(B.UNPACK_SKIP_PIXELS,Zi),Se.pixelStorei(B.UNPACK_SKIP_ROWS,Yt),Se.pixelStorei(B.UNPACK_SKIP_IMAGES,gn),xe===0&&L.generateMipmaps===!0&&L.mipmapsAutoUpdate===!0&&B.generateMipmap(Pe),Se.unbindTexture()},this.initRenderTarget=function(v){Be.get(v).__webglFramebuffer===void 0&&We.setupRenderTarget(v)},this.initTexture=function(v){v.isCubeTexture?We.setTextureCube(v,0):v.isData3DTexture?We.setTexture3D(v,0):v.isDataArrayTexture||v.isCompressedArrayTexture?We.setTexture2DArray(v,0):We.setTexture2D(v,0),Se.unbindTexture()},this.resetState=function(){ne=0,O=0,ue=null,Se.reset(),ge.reset()},typeof __THREE_DEVTOOLS__<"u"&&__THREE_DEVTOOLS__.dispatchEvent(new CustomEvent("observe",{detail:this}))}get coordinateSystem(){return hi}get outputColorSpace(){return this._outputColorSpace}set outputColorSpace(e){this._outputColorSpace=e;let t=this.getContext();t.drawingBufferColorSpace=je._getDrawingBufferColorSpace(e),t.unpackColorSpace=je._getUnpackColorSpace()}};var ym={type:"change"},Qc={type:"start"},Sm={type:"end"},vl=new Yi,vm=new si,vM=Math.cos(70*Eo.DEG2RAD),jt=new I,Oi=2*Math.PI,Mt={NONE:-1,ROTATE:0,DOLLY:1,PAN:2,TOUCH_ROTATE:3,TOUCH_PAN:4,TOUCH_DOLLY_PAN:5,TOUCH_DOLLY_ROTATE:6},jc=1e-6,Sl=class extends Do{constructor(e,t=null){super(e,t),this.state=Mt.NONE,this.target=new I,this.cursor=new I,this.minDistance=0,this.maxDistance=1/0,this.minZoom=0,this.maxZoom=1/0,this.minTargetRadius=0,this.maxTargetRadius=1/0,this.minPolarAngle=0,this.maxPolarAngle=Math.PI,this.minAzimuthAngle=-1/0,this.maxAzimuthAngle=1/0,this.enableDamping=!1,this.dampingFactor=.05,this.enableZoom=!0,this.zoomSpeed=1,this.enableRotate=!0,this.rotateSpeed=1,this.keyRotateSpeed=1,this.enablePan=!0,this.panSpeed=1,this.screenSpacePanning=!0,this.keyPanSpeed=7,this.zoomToCursor=!1,this.autoRotate=!1,this.autoRotateSpeed=2,this.keys={LEFT:"ArrowLeft",UP:"ArrowUp",RIGHT:"ArrowRight",BOTTOM:"ArrowDown"},this.mouseButtons={LEFT:mr.ROTATE,MIDDLE:mr.DOLLY,RIGHT:mr.PAN},this.touches={ONE:gr.ROTATE,TWO:gr.DOLLY_PAN},this.target0=this.target.clone(),this.position0=this.object.position.clone(),this.zoom0=this.object.zoom,this._cursorStyle="auto",this._domElementKeyEvents=null,this._lastPosition=new I,this._lastQuaternion=new yi,this._lastTargetPosition=new I,this._quat=new yi().setFromUnitVectors(e.up,new I(0,1,0)),this._quatInverse=this._quat.clone().invert(),this._spherical=new bs,this._sphericalDelta=new bs,this._scale=1,this._panOffset=new I,this._rotateStart=new Oe,this._rotateEnd=new Oe,this._rotateDelta=new Oe,this._panStart=new Oe,this._panEnd=new Oe,this._panDelta=new Oe,this._dollyStart=new Oe,this._dollyEnd=new Oe,this._dollyDelta=new Oe,this._dollyDirection=new I,this._mouse=new Oe,this._performCursorZoom=!1,this._pointers=[],this._pointerPositions={},this._controlActive=!1,this._onPointerMove=EM.bind(this),this._onPointerDown=SM.bind(this),this._onPointerUp=bM.bind(this),this._onContextMenu=FM.bind(this),this._onMouseWheel=RM.bind(this),this._onKeyDown=wM.bind(this),this._onTouchStart=CM.bind(this),this._onTouchMove=PM.bind(this),this._onMouseDown=TM.bind(this),this._onMouseMove=AM.bind(this),this._interceptControlDown=DM.bind(this),this._interceptControlUp=LM.bind(this),this.domElement!==null&&this.connect(this.domElement),this.update()}set cursorStyle(e){this._cursorStyle=e,e==="grab"?this.domElement.style.cursor="grab":this.domElement.style.cursor="auto"}get cursorStyle(){return this._cursorStyle}connect(e){super.connect(e),this.domElement.addEventListener("pointerdown",this._onPointerDown),this.domElement.addEventListener("pointercancel",this._onPointerUp),this.domElement.addEventListener("contextmenu",this._onContextMenu),this.domElement.addEventListener("wheel",this._onMouseWheel,{passive:!1}),this.domElement.ownerDocument.addEventListener("keydown",this._interceptControlDown,{passive:!0,capture:!0}),this.domElement.style.touchAction="none"}disconnect(){this.state=Mt.NONE,this.domElement.removeEventListener("pointerdown",this._onPointerDown),this.domElement.ownerDocument.removeEventListener("pointermove",this._onPointerMove),this.domElement.ownerDocument.removeEventListener("pointerup",this._onPointerUp),this.domElement.removeEventListener("pointercancel",this._onPointerUp),this.domElement.removeEventListener("wheel",this._onMouseWheel),this.domElement.removeEventListener("contextmenu",this._onContextMenu),this.stopListenToKeyEvents(),this.domElement.ownerDocument.removeEventListener("keydown",this._interceptControlDown,{capture:!0}),this.domElement.ownerDocument.removeEventListener("keyup",this._interceptControlUp,{capture:!0}),this._controlActive=!1,this._pointers.length=0,this._pointerPositions={},this.domElement.style.touchAction="",this.domElement.style.cursor="auto"}dispose(){this.disconnect()}getPolarAngle(){return this._spherical.phi}getAzimuthalAngle(){return this._spherical.theta}getDistance(){return this.object.position.distanceTo(this.target)}listenToKeyEvents(e){e.addEventListener("keydown",this._onKeyDown),this._domElementKeyEvents=e}stopListenToKeyEvents(){this._domElementKeyEvents!==null&&(this._domElementKeyEvents.removeEventListener("keydown",this._onKeyDown),this._domElementKeyEvents=null)}saveState(){this.target0.copy(this.target),this.position0.copy(this.object.position),this.zoom0=this.object.zoom}reset(){this.target.copy(this.target0),this.object.position.copy(this.position0),this.object.zoom=this.zoom0,this.object.updateProjectionMatrix(),this.dispatchEvent(ym),this.update(),this.state=Mt.NONE}pan(e,t){this._pan(e,t),this.update()}dollyIn(e){this._dollyIn(e),this.update()}dollyOut(e){this._dollyOut(e),this.update()}rotateLeft(e){this._rotateLeft(e),this.update()}rotateUp(e){this._rotateUp(e),this.update()}update(e=null){let t=this.object.position;jt.copy(t).sub(this.target),jt.applyQuaternion(this._quat),this._spherical.setFromVector3(jt),this.autoRotate&&this.state===Mt.NONE&&this._rotateLeft(this._getAutoRotationAngle(e)),this.enableDamping?(this._spherical.theta+=this._sphericalDelta.theta*this.dampingFactor,this._spherical.phi+=this._sphericalDelta.phi*this.dampingFactor):(this._spherical.theta+=this._sphericalDelta.theta,this._spherical.phi+=this._sphericalDelta.phi);let n=this.minAzimuthAngle,r=this.maxAzimuthAngle;isFinite(n)&&isFinite(r)&&(n<-Math.PI?n+=Oi:n>Math.PI&&(n-=Oi),r<-Math.PI?r+=Oi:r>Math.PI&&(r-=Oi),n<=r?this._spherical.theta=Math.max(n,Math.min(r,this._spherical.theta)):this._spherical.theta=this._spherical.theta>(n+r)/2?Math.max(n,this._spherical.theta):Math.min(r,this._spherical.theta)),this._spherical.phi=Math.max(this.minPolarAngle,Math.min(this.maxPolarAngle,this._spherical.phi)),this._spherical.makeSafe(),this.enableDamping===!0?this.target.addScaledVector(this._panOffset,this.dampingFactor):this.target.add(this._panOffset),this.target.sub(this.cursor),this.target.clampLength(this.minTargetRadius,this.maxTargetRadius),this.target.add(this.cursor);let s=!1;if(this.zoomToCursor&&this._performCursorZoom||this.object.isOrthographicCamera)this._spherical.radius=this._clampDistance(this._spherical.radius);else{let o=this._spherical.radius;this._spherical.radius=this._clampDistance(this._spherical.radius*this._scale),s=o!=this._spherical.radius}if(jt.setFromSpherical(this._spherical),jt.applyQuaternion(this._quatInverse),t.copy(this.target).add(jt),this.object.lookAt(this.target),this.enableDamping===!0?(this._sphericalDelta.theta*=1-this.dampingFactor,this._sphericalDelta.phi*=1-this.dampingFactor,this._panOffset.multiplyScalar(1-this.dampingFactor)):(this._sphericalDelta.set(0,0,0),this._panOffset.set(0,0,0)),this.zoomToCursor&&this._performCursorZoom){let o=null;if(this.object.isPerspectiveCamera){let a=jt.length();o=this._clampDistance(a*this._scale);let l=a-o;this.object.position.addScaledVector(this._dollyDirection,l),this.object.updateMatrixWorld(),s=!!l}else if(this.object.isOrthographicCamera){let a=new I(this._mouse.x,this._mouse.y,0);a.unproject(this.object);let l=this.object.zoom;this.object.zoom=Math.max(this.minZoom,Math.min(this.maxZoom,this.object.zoom/this._scale)),this.object.updateProjectionMatrix(),s=l!==this.object.zoom;let c=new I(this._mouse.x,this._mouse.y,0);c.unproject(this.object),this.object.position.sub(c).add(a),this.object.updateMatrixWorld(),o=jt.length()}else console.warn("WARNING: OrbitControls.js encountered an unknown camera type - zoom to cursor disabled."),this.zoomToCursor=!1;o!==null&&(this.screenSpacePanning?this.target.set(0,0,-1).transformDirection(this.object.matrix).multiplyScalar(o).add(this.object.position):(vl.origin.copy(this.object.position),vl.direction.set(0,0,-1).transformDirection(this.object.matrix),Math.abs(this.object.up.dot(vl.direction))<vM?this.object.lookAt(this.target):(vm.setFromNormalAndCoplanarPoint(this.object.up,this.target),vl.intersectPlane(vm,this.target))))}else if(this.object.isOrthographicCamera){let o=this.object.zoom;this.object.zoom=Math.max(this.minZoom,Math.min(this.maxZoom,this.object.zoom/this._scale)),o!==this.object.zoom&&(this.object.updateProjectionMatrix(),s=!0)}return this._scale=1,this._performCursorZoom=!1,s||this._lastPosition.distanceToSquared(this.object.position)>jc||8*(1-this._lastQuaternion.dot(this.object.quaternion))>jc||this._lastTargetPosition.distanceToSquared(this.target)>jc?(this.dispatchEvent(ym),this._lastPosition.copy(this.object.position),this._lastQuaternion.copy(this.object.quaternion),this._lastTargetPosition.copy(this.target),!0):!1}_getAutoRotationAngle(e){return e!==null?Oi/60*this.autoRotateSpeed*e:Oi/60/60*this.autoRotateSpeed}_getZoomScale(e){let t=Math.abs(e*.01);return Math.pow(.95,this.zoomSpeed*t)}_rotateLeft(e){this._sphericalDelta.theta-=e}_rotateUp(e){this._sphericalDelta.phi-=e}_panLeft(e,t){jt.setFromMatrixColumn(t,0),jt.multiplyScalar(-e),this._panOffset.add(jt)}_panUp(e,t){this.screenSpacePanning===!0?jt.setFromMatrixColumn(t,1):(jt.setFromMatrixColumn(t,0),jt.crossVectors(this.object.up,jt)),jt.multiplyScalar(e),this._panOffset.add(jt)}_pan(e,t){let n=this.domElement;if(this.object.isPerspectiveCamera){let r=this.object.position;jt.copy(r).sub(this.target);let s=jt.length();s*=Math.tan(this.object.fov/2*Math.PI/180),this._panLeft(2*e*s/n.clientHeight,this.object.matrix),this._panUp(2*t*s/n.clientHeight,this.object.matrix)}else this.object.isOrthographicCamera?(this._panLeft(e*(this.object.right-this.object.left)/this.object.zoom/n.clientWidth,this.object.matrix),this._panUp(t*(this.object.top-this.object.bottom)/this.object.zoom/n.clientHeight,this.object.matrix)):(console.warn("WARNING: OrbitControls.js encountered an unknown camera type - pan disabled."),this.enablePan=!1)}_dollyOut(e){this.object.isPerspectiveCamera||this.object.isOrthographicCamera?this._scale/=e:(console.warn("WARNING: OrbitControls.js encountered an unknown camera type - dolly/zoom disabled."),this.enableZoom=!1)}_dollyIn(e){this.object.isPerspectiveCamera||this.object.isOrthographicCamera?this._scale*=e:(console.warn("WARNING: OrbitControls.js encountered an unknown camera type - dolly/zoom disabled."),this.enableZoom=!1)}_updateZoomParameters(e,t){if(!this.zoomToCursor)return;this._performCursorZoom=!0;let n=this.domElement.getBoundingClientRect(),r=e-n.left,s=t-n.top,o=n.width,a=n.height;this._mouse.x=r/o*2-1,this._mouse.y=-(s/a)*2+1,this._dollyDirection.set(this._mouse.x,this._mouse.y,1).unproject(this.object).sub(this.object.position).normalize()}_clampDistance(e){return Math.max(this.minDistance,Math.min(this.maxDistance,e))}_handleMouseDownRotate(e){this._rotateStart.set(e.clientX,e.clientY)}_handleMouseDownDolly(e){this._updateZoomParameters(e.clientX,e.clientY),this._dollyStart.set(e.clientX,e.clientY)}_handleMouseDownPan(e){this._panStart.set(e.clientX,e.clientY)}_handleMouseMoveRotate(e){this._rotateEnd.set(e.clientX,e.clientY),this._rotateDelta.subVectors(this._rotateEnd,this._rotateStart).multiplyScalar(this.rotateSpeed);let t=this.domElement;this._rotateLeft(Oi*this._rotateDelta.x/t.clientHeight),this._rotateUp(Oi*this._rotateDelta.y/t.clientHeight),this._rotateStart.copy(this._rotateEnd),this.update()}_handleMouseMoveDolly(e){this._dollyEnd.set(e.clientX,e.clientY),this._dollyDelta.subVectors(this._dollyEnd,this._dollyStart),this._dollyDelta.y>0?this._dollyOut(this._getZoomScale(this._dollyDelta.y)):this._dollyDelta.y<0&&this._dollyIn(this._getZoomScale(this._dollyDelta.y)),this._dollyStart.copy(this._dollyEnd),this.zoomToCursor&&(this._performCursorZoom=!0,this._dollyDirection.set(this._mouse.x,this._mouse.y,1).unproject(this.object).sub(this.object.position).normalize()),this.update()}_handleMouseMovePan(e){this._panEnd.set(e.clientX,e.clientY),this._panDelta.subVectors(this._panEnd,this._panStart).multiplyScalar(this.panSpeed),this._pan(this._panDelta.x,this._panDelta.y),this._panStart.copy(this._panEnd),this.update()}_handleMouseWheel(e){this._updateZoomParameters(e.clientX,e.clientY),e.deltaY<0?this._dollyIn(this._getZoomScale(e.deltaY)):e.deltaY>0&&this._dollyOut(this._getZoomScale(e.deltaY)),this.update()}_handleKeyDown(e){let t=!1;switch(e.code){case this.keys.UP:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateUp(Oi*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(0,this.keyPanSpeed),t=!0;break;case this.keys.BOTTOM:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateUp(-Oi*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(0,-this.keyPanSpeed),t=!0;break;case this.keys.LEFT:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateLeft(Oi*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(this.keyPanSpeed,0),t=!0;break;case this.keys.RIGHT:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateLeft(-Oi*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(-this.keyPanSpeed,0),t=!0;break}t&&(e.preventDefault(),this.update())}_handleTouchStartRotate(e){if(this._pointers.length===1)this._rotateStart.set(e.pageX,e.pageY);else{let t=this._getSecondPointerPosition(e),n=.5*(e.pageX+t.x),r=.5*(e.pageY+t.y);this._rotateStart.set(n,r)}}_handleTouchStartPan(e){if(this._pointers.length===1)this._panStart.set(e.pageX,e.pageY);else{let t=this._getSecondPointerPosition(e),n=.5*(e.pageX+t.x),r=.5*(e.pageY+t.y);this._panStart.set(n,r)}}_handleTouchStartDolly(e){let t=this._getSecondPointerPosition(e),n=e.pageX-t.x,r=e.pageY-t.y,s=Math.sqrt(n*n+r*r);this._dollyStart.set(0,s)}_handleTouchStartDollyPan(e){this.enableZoom&&this._handleTouchStartDolly(e),this.enablePan&&this._handleTouchStartPan(e)}_handleTouchStartDollyRotate(e){this.enableZoom&&this._handleTouchStartDolly(e),this.enableRotate&&this._handleTouchStartRotate(e)}_handleTouchMoveRotate(e){if(this._pointers.length==1)this._rotateEnd.set(e.pageX,e.pageY);else{let n=this._getSecondPointerPosition(e),r=.5*(e.pageX+n.x),s=.5*(e.pageY+n.y);this._rotateEnd.set(r,s)}this._rotateDelta.subVectors(this._rotateEnd,this._rotateStart).multiplyScalar(this.rotateSpeed);let t=this.domElement;this._rotateLeft(Oi*this._rotateDelta.x/t.clientHeight),this._rotateUp(Oi*this._rotateDelta.y/t.clientHeight),this._rotateStart.copy(this._rotateEnd)}_handleTouchMovePan(e){if(this._pointers.length===1)this._panEnd.set(e.pageX,e.pageY);else{let t=this._getSecondPointerPosition(e),n=.5*(e.pageX+t.x),r=.5*(e.pageY+t.y);this._panEnd.set(n,r)}this._panDelta.subVectors(this._panEnd,this._panStart).multiplyScalar(this.panSpeed),this._pan(this._panDelta.x,this._panDelta.y),this._panStart.copy(this._panEnd)}_handleTouchMoveDolly(e){let t=this._getSecondPointerPosition(e),n=e.pageX-t.x,r=e.pageY-t.y,s=Math.sqrt(n*n+r*r);this._dollyEnd.set(0,s),this._dollyDelta.set(0,Math.pow(this._dollyEnd.y/this._dollyStart.y,this.zoomSpeed)),this._dollyOut(this._dollyDelta.y),this._dollyStart.copy(this._dollyEnd);let o=(e.pageX+t.x)*.5,a=(e.pageY+t.y)*.5;this._updateZoomParameters(o,a)}_handleTouchMoveDollyPan(e){this.enableZoom&&this._handleTouchMoveDolly(e),this.enablePan&&this._handleTouchMovePan(e)}_handleTouchMoveDollyRotate(e){this.enableZoom&&this._handleTouchMoveDolly(e),this.enableRotate&&this._handleTouchMoveRotate(e)}_addPointer(e){this._pointers.push(e.pointerId)}_removePointer(e){delete this._pointerPositions[e.pointerId];for(let t=0;t<this._pointers.length;t++)if(this._pointers[t]==e.pointerId){this._pointers.splice(t,1);return}}_isTrackingPointer(e){for(let t=0;t<this._pointers.length;t++)if(this._pointers[t]==e.pointerId)return!0;return!1}_trackPointer(e){let t=this._pointerPositions[e.pointerId];t===void 0&&(t=new Oe,this._pointerPositions[e.pointerId]=t),t.set(e.pageX,e.pageY)}_getSecondPointerPosition(e){let t=e.pointerId===this._pointers[0]?this._pointers[1]:this._pointers[0];return this._pointerPositions[t]}_customWheelEvent(e){let t=e.deltaMode,n={clientX:e.clientX,clientY:e.clientY,deltaY:e.deltaY};switch(t){case 1:n.deltaY*=16;break;case 2:n.deltaY*=100;break}return e.ctrlKey&&!this._controlActive&&(n.deltaY*=10),n}};function SM(i){this.enabled!==!1&&(this._pointers.length===0&&(this.domElement.setPointerCapture(i.pointerId),this.domElement.ownerDocument.addEventListener("pointermove",this._onPointerMove),this.domElement.ownerDocument.addEventListener("pointerup",this._onPointerUp)),!this._isTrackingPointer(i)&&(this._addPointer(i),i.pointerType==="touch"?this._onTouchStart(i):this._onMouseDown(i),this._cursorStyle==="grab"&&(this.domElement.style.cursor="grabbing")))}function EM(i){this.enabled!==!1&&(i.pointerType==="touch"?this._onTouchMove(i):this._onMouseMove(i))}function bM(i){switch(this._removePointer(i),this._pointers.length){case 0:this.domElement.releasePointerCapture(i.pointerId),this.domElement.ownerDocument.removeEventListener("pointermove",this._onPointerMove),this.domElement.ownerDocument.removeEventListener("pointerup",this._onPointerUp),this.dispatchEvent(Sm),this.state=Mt.NONE,this._cursorStyle==="grab"&&(this.domElement.style.cursor="grab");break;case 1:let e=this._pointers[0],t=this._pointerPositions[e];this._onTouchStart({pointerId:e,pageX:t.x,pageY:t.y});break}}function TM(i){let e;switch(i.button){case 0:e=this.mouseButtons.LEFT;break;case 1:e=this.mouseButtons.MIDDLE;break;case 2:e=this.mouseButtons.RIGHT;break;default:e=-1}switch(e){case mr.DOLLY:if(this.enableZoom===!1)return;this._handleMouseDownDolly(i),this.state=Mt.DOLLY;break;case mr.ROTATE:if(i.ctrlKey||i.metaKey||i.shiftKey){if(this.enablePan===!1)return;this._handleMouseDownPan(i),this.state=Mt.PAN}else{if(this.enableRotate===!1)return;this._handleMouseDownRotate(i),this.state=Mt.ROTATE}break;case mr.PAN:if(i.ctrlKey||i.metaKey||i.shiftKey){if(this.enableRotate===!1)return;this._handleMouseDownRotate(i),this.state=Mt.ROTATE}else{if(this.enablePan===!1)return;this._handleMouseDownPan(i),this.state=Mt.PAN}break;default:this.state=Mt.NONE}this.state!==Mt.NONE&&this.dispatchEvent(Qc)}function AM(i){switch(this.state){case Mt.ROTATE:if(this.enableRotate===!1)return;this._handleMouseMoveRotate(i);break;case Mt.DOLLY:if(this.enableZoom===!1)return;this._handleMouseMoveDolly(i);break;case Mt.PAN:if(this.enablePan===!1)return;this._handleMouseMovePan(i);break}}function RM(i){this.enabled===!1||this.enableZoom===!1||this.state!==Mt.NONE||(i.preventDefault(),this.dispatchEvent(Qc),this._handleMouseWheel(this._customWheelEvent(i)),this.dispatchEvent(Sm))}function wM(i){this.enabled!==!1&&this._handleKeyDown(i)}function CM(i){switch(this._trackPointer(i),this._pointers.length){case 1:switch(this.touches.ONE){case gr.ROTATE:if(this.enableRotate===!1){this.state=Mt.NONE;break}this._handleTouchStartRotate(i),this.state=Mt.TOUCH_ROTATE;break;case gr.PAN:if(this.enablePan===!1){this.state=Mt.NONE;break}this._handleTouchStartPan(i),this.state=Mt.TOUCH_PAN;break;default:this.state=Mt.NONE}break;case 2:switch(this.touches.TWO){case gr.DOLLY_PAN:if(this.enableZoom===!1&&this.enablePan===!1)return;this._handleTouchStartDollyPan(i),this.state=Mt.TOUCH_DOLLY_PAN;break;case gr.DOLLY_ROTATE:if(this.enableZoom===!1&&this.enableRotate===!1)return;this._handleTouchStartDollyRotate(i),this.state=Mt.TOUCH_DOLLY_ROTATE;break;default:this.state=Mt.NONE}break;default:this.state=Mt.NONE}this.state!==Mt.NONE&&this.dispatchEvent(Qc)}function PM(i){switch(this._trackPointer(i),this.state){case Mt.TOUCH_ROTATE:if(this.enableRotate===!1)return;this._handleTouchMoveRotate(i),this.update();break;case Mt.TOUCH_PAN:if(this.enablePan===!1)return;this._handleTouchMovePan(i),this.update();break;case Mt.TOUCH_DOLLY_PAN:if(this.enableZoom===!1&&this.enablePan===!1)return;this._handleTouchMoveDollyPan(i),this.update();break;case Mt.TOUCH_DOLLY_ROTATE:if(this.enableZoom===!1&&this.enableRotate===!1)return;this._handleTouchMoveDollyRotate(i),this.update();break;default:this.state=Mt.NONE}}function FM(i){this.enabled!==!1&&i.preventDefault()}function DM(i){i.key==="Control"&&(this._controlActive=!0,this.domElement.ownerDocument.addEventListener("keyup",this._interceptControlUp,{passive:!0,capture:!0}))}function LM(i){i.key==="Control"&&(this._controlActive=!1,this.domElement.ownerDocument.removeEventListener("keyup",this._interceptControlUp,{passive:!0,capture:!0}))}var As=["#440154","#472d7b","#3b528b","#2c728e","#21918c","#28ae80","#5ec962","#addc30","#fde725"];function Em(){let i=new Uint8Array(As.flatMap(t=>[1,3,5].map(n=>parseInt(t.slice(n,n+2),16)).concat(255))),e=new Cr(i,As.length,1);return e.minFilter=e.magFilter=Bt,e.needsUpdate=!0,e}var El=class{constructor(e){this.cameras=e,this.lines=new Hn(new Et,new $i({color:"#ff9d3c"})),this.chosen=new Hn(new Et,new $i({color:"#ffffff",depthTest:!1})),this.group=new vi().add(this.lines,this.chosen),this.size=0}fit(e){Math.abs(Math.log(e/this.size))<.2||(this.size=e,bm(this.lines,this.cameras.flatMap(t=>Tm(t,e))),this.choose(this.number??null))}choose(e){this.number=e,bm(this.chosen,e===null?[]:Tm(this.cameras[e],1.5*this.size))}pick(e,t,n,r,s){let o=null;return this.cameras.forEach(({at:a},l)=>{let c=new I(...a).project(n);if(c.z>1||Math.hypot((c.x/2+.5)*r.x-e,(.5-c.y/2)*r.y-t)>s)return;let u=new I(...a).applyMatrix4(n.matrixWorldInverse).z*-1;(!o||u<o.depth)&&(o={number:l,depth:u})}),o}},bm=(i,e)=>{i.geometry.dispose(),i.geometry=new Et,i.geometry.setAttribute("position",new Ft(e,3)),i.frustumCulled=!1},Tm=({at:i,corners:e},t)=>{let n=e.map(s=>s.map((o,a)=>i[a]+t*o)),r=[0,1,2].map(s=>(1.5*(n[0][s]+n[1][s])-.5*(n[2][s]+n[3][s]))/2);return n.flatMap((s,o)=>[...i,...s,...s,...n[(o+1)%4]]).concat(n[0],r,r,n[1])};function Am(i,e){let t=new Et;t.setAttribute("position",new Ft(e.flatMap(([s,o])=>[...i[s].at,...i[o].at]),3));let n=As.map(s=>new $e(s)),r=e.flatMap((s,o)=>{let{r:a,g:l,b:c}=n[Math.floor(o/e.length*n.length)];return[a,l,c,a,l,c]});return t.setAttribute("color",new Ft(r,3)),new Hn(t,new $i({vertexColors:!0,transparent:!0,opacity:.8}))}var Vl=Lu(bg(),1),Rg=Lu(uu(),1);var Tg=4e6,vv=4,Sv=1.5,Ag=["X","Y","Z","Red","Green","Blue","sigma_m","views"],mu=["colour","height","sigma","images"],Ev=`
  #include <clipping_planes_pars_vertex>
  attribute vec3 colour; attribute float sigma; attribute float views;
  uniform int look; uniform vec2 range; uniform float gain, spacing, size, perUnit; uniform sampler2D ramp;
  varying vec3 shown;
  void main() {
    vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * mvPosition;
    gl_PointSize = clamp(1.6 * size * spacing * perUnit / -mvPosition.z, 1.5, 9.0);
    float value = look == 1 ? position.z : look == 2 ? sigma : views;
    float share = (value - range.x) / max(range.y - range.x, 1e-9);
    shown = look == 0 ? min(colour * gain, 1.0) : value == value ? texture2D(ramp, vec2(share, 0.5)).rgb : vec3(0.5);
    #include <clipping_planes_vertex>
  }`,bv=`
  #include <clipping_planes_pars_fragment>
  varying vec3 shown;
  void main() {
    #include <clipping_planes_fragment>
    vec2 away = gl_PointCoord - 0.5;
    if (dot(away, away) > 0.25) discard;
    gl_FragColor = vec4(shown, 1.0);
  }`,Ds=(i,e)=>i[Math.min(i.length-1,Math.floor(e*i.length))],Wl=class{constructor(e,t,n,r){this.url=e,this.middle=t,this.changed=r,this.group=new vi,this.nodes=new Map,this.loading=0,this.material=new ai({vertexShader:Ev,fragmentShader:bv,clipping:!0,clippingPlanes:n,uniforms:{look:{value:0},range:{value:new Oe},gain:{value:1},spacing:{value:1},size:{value:1},perUnit:{value:1},ramp:{value:Em()}}})}async open(){this.get=async(s,o)=>{let a=await fetch(this.url,{headers:{Range:`bytes=${s}-${o-1}`}});if(a.status!==206)throw new Error(`${this.url}: ${a.status} ${a.statusText}`);return new Uint8Array(await a.arrayBuffer())},this.lazPerf=await(0,Rg.createLazPerf)({locateFile:s=>s}),this.copc=await Vl.Copc.create(this.get);let{cube:e,rootHierarchyPage:t}=this.copc.info,{nodes:n}=await Vl.Copc.loadHierarchyPage(this.get,t),r=e[3]-e[0];for(let[s,o]of Object.entries(n)){let[a,...l]=s.split("-").map(Number),c=r/2**a,u=new I(...l.map((d,g)=>e[g]+d*c-this.middle[g])),h=new Xi(u,u.clone().addScalar(c));this.nodes.set(s,{key:s,level:a,cell:l,told:o,box:h,spacing:this.copc.info.spacing/2**a,points:null})}for(let s of this.nodes.values())s.children=[0,1,2,3,4,5,6,7].map(o=>[s.level+1,...s.cell.map((a,l)=>2*a+(o>>l&1))].join("-")).filter(o=>this.nodes.has(o));if(this.root=this.nodes.get("0-0-0-0"),!this.root)throw new Error("the cloud has no points");await this.load(this.root),this.survey()}survey(){let{position:e,colour:t,sigma:n,views:r}=this.root.points.geometry.attributes,s=[0,1,2].map(c=>e.array.filter((u,h)=>h%3===c).sort());this.low=s.map(c=>Ds(c,.005)),this.high=s.map(c=>Ds(c,.995)),this.most=new Xi(...[.25,.75].map(c=>new I(...s.map(u=>Ds(u,c)))));let o=n.array.filter(Number.isFinite).sort(),a=(c,u)=>c.length?[Ds(c,u),Ds(c,1-u)]:[0,1];this.ranges={height:a(s[2],.02),sigma:a(o,.03),images:a(r.array.slice().sort(),.02)};let l=Ds(t.array.slice().sort(),.98);this.material.uniforms.gain.value=Math.min(1.7,250/Math.max(l,1))}look(e){this.material.uniforms.look.value=mu.indexOf(e),this.ranges[e]&&this.material.uniforms.range.value.set(...this.ranges[e])}async load(e){this.loading++;try{let{pointCount:t}=e.told,n=await Vl.Copc.loadPointDataView(this.get,this.copc,e.told,{lazPerf:this.lazPerf,include:Ag}),[r,s,o,a,l,c,u,h]=Ag.map(m=>m in n.dimensions?n.getter(m):()=>NaN),d=new Float32Array(3*t),g=new Uint8Array(3*t),M=new Float32Array(t),S=new Uint8Array(t);for(let m=0;m<t;m++)[r,s,o].forEach((b,w)=>{d[3*m+w]=b(m)-this.middle[w]}),[a,l,c].forEach((b,w)=>{g[3*m+w]=b(m)>>8}),M[m]=u(m),S[m]=h(m);let _=new Et;_.setAttribute("position",new ni(d,3)),_.setAttribute("colour",new ni(g,3,!0)),_.setAttribute("sigma",new ni(M,1)),_.setAttribute("views",new ni(S,1)),e.points=new Lr(_,this.material),e.points.frustumCulled=!1,e.points.onBeforeRender=()=>{this.material.uniforms.spacing.value=e.shownSpacing,this.material.uniformsNeedUpdate=!0},this.group.add(e.points)}finally{this.loading--}}update(e,t){let n=t/2/Math.tan(Eo.degToRad(e.fov/2));this.material.uniforms.perUnit.value=n*Math.min(window.devicePixelRatio,2);let r=new tn().setFromProjectionMatrix(new tt().multiplyMatrices(e.projectionMatrix,e.matrixWorldInverse)),s=[],o=h=>{if(!r.intersectsBox(h.box))return;let d=Math.max(h.box.distanceToPoint(e.position),e.near);h.pixels=h.spacing*n/d,s.push(h),h.pixels>Sv&&h.children.forEach(g=>o(this.nodes.get(g)))};o(this.root),s.sort((h,d)=>d.pixels-h.pixels);let a=0,l=s.filter(h=>(a+=h.told.pointCount)<=Tg),c=new Set(l);this.shown=0;let u=a+Tg;for(let h of this.nodes.values())h.points&&(h.points.visible=c.has(h),h.points.visible&&(this.shown+=h.told.pointCount),u-=h.told.pointCount,!(u>=0||c.has(h)||h===this.root)&&(this.group.remove(h.points),h.points.geometry.dispose(),h.points=null));return l.slice().reverse().forEach(h=>{let d=h.children.map(g=>this.nodes.get(g)).filter(g=>g.points?.visible);h.shownSpacing=d.length?Math.min(...d.map(g=>g.shownSpacing??g.spacing)):h.spacing}),this.queue=l.filter(h=>!h.points&&!h.asked),this.fetch(),!this.loading}fetch(){for(;this.loading<vv&&this.queue.length;){let e=this.queue.shift();e.asked=!0,this.load(e).then(()=>this.changed(),t=>this.changed(t)).finally(()=>{e.asked=!1,this.fetch()})}}pick(e,t,n,r,s,o){let a=new tt().multiplyMatrices(n.projectionMatrix,n.matrixWorldInverse).elements,l=new Fo;l.setFromCamera(new Oe(2*e/r.x-1,1-2*t/r.y),n);let c=null,u=1/0;for(let h of this.nodes.values()){if(!h.points?.visible)continue;let d=h.box.distanceToPoint(n.position)+h.box.getSize(new I).length(),g=h.box.clone().expandByScalar(d*s/this.material.uniforms.perUnit.value);if(!l.ray.intersectsBox(g))continue;let M=h.points.geometry.attributes.position.array;for(let S=0;S<M.length;S+=3){let _=a[3]*M[S]+a[7]*M[S+1]+a[11]*M[S+2]+a[15];if(_<=0)continue;let m=((a[0]*M[S]+a[4]*M[S+1]+a[8]*M[S+2]+a[12])/_/2+.5)*r.x-e,b=(.5-(a[1]*M[S]+a[5]*M[S+1]+a[9]*M[S+2]+a[13])/_/2)*r.y-t,w=Math.hypot(m,b),R=_*(1+.02*w);w<s&&R<u&&o(M[S],M[S+1],M[S+2])&&(u=R,c={at:[M[S],M[S+1],M[S+2]],depth:_})}}return c}};var Tt=(i,e={},...t)=>{let n=Object.assign(document.createElement(i),e);return n.append(...t),n},ko=(i,e,t=3)=>i===null?"not known":e!=="m"?`${i.toPrecision(4)} ${e}`:Math.abs(i)<.1?`${(i*1e3).toFixed(1)} mm`:`${i.toFixed(t)} m`,Xl=i=>i.crs?["east","north","height"]:["x","y","z"],Ho=async i=>{let e=await fetch(i),t=await e.json();if(!e.ok)throw new Error(t.error);return t};var ql=160,Tv=24;function wg(i,e,t){let n=e.unit==="m"?" m":"",r=(w,...R)=>Tt("tr",{},Tt("th",{textContent:w}),Tt("td",{},...R)),s=e.unit==="m"?3:6,o=Xl(e).map((w,R)=>r(w,i.xyz[R].toFixed(s)+n));if(i.geodetic){let[w,R,P]=i.geodetic;o.push(r("lat, lon",`${w.toFixed(8)}, ${R.toFixed(8)}`)),Math.abs(P-i.xyz[2])>5e-4&&o.push(r("on the ellipsoid",`${P.toFixed(3)} m`))}let{world:a,placed:l,model:c,point:u}=i.sigma,h=w=>ko(w,e.unit);o.push(r("sigma",Tt("b",{textContent:a===null?"in the world: not known":h(a)}))),l&&o.push(r("\xB7 place",`east ${h(l[0])}, north ${h(l[1])}, up ${h(l[2])}`)),o.push(r("\xB7 model",h(c)),r("\xB7 point",h(u)),r("depth maps",`${i.views}`));let d=w=>i.images.filter(R=>R.hidden===w),g=d(!1),M=d(null),S=d(!0).length,m=`Images: ${[g.length&&`${g.length} see it`,M.length&&`${M.length} may: no depth there (pale)`,S&&`hidden from ${S}`].filter(Boolean).join(", ")||"none"}`,b=Tt("div",{className:"patches"},...[...g,...M].slice(0,Tv).map(w=>Av(w,e,t)));return[Tt("table",{},...o),Tt("p",{textContent:m}),b]}function Av({image:i,xy:e,hidden:t},n,r){let[s,o]=e.map(u=>Math.round(u-ql/2)),{name:a}=n.cameras[i],l=Tt("img",{src:`patch?k=${i}&left=${s}&top=${o}&size=${ql}`,alt:a,loading:"lazy"}),c=Tt("button",{title:a,onclick:()=>r(i,e)},l,Cg([e[0]-s,e[1]-o],[ql,ql]));return Tt("figure",{className:t===null?"pale":""},c,Tt("figcaption",{textContent:a}))}function Cg(i,e){let t=Tt("i",{className:"cross"});return t.style.left=`${100*i[0]/e[0]}%`,t.style.top=`${100*i[1]/e[1]}%`,t}function Pg(i,e,t,n,r){let{name:s,size:o}=n.cameras[e],a=()=>{i.hidden=!0,i.replaceChildren()},l=Tt("div",{className:"frame"},Tt("img",{src:`image?k=${e}&width=2048`,alt:s}));return t&&l.append(Cg(t,o)),l.style.aspectRatio=`${o[0]} / ${o[1]}`,l.style.setProperty("--ratio",o[0]/o[1]),i.replaceChildren(Tt("header",{},Tt("b",{textContent:s}),` ${o[0]} \xD7 ${o[1]}${t?` \xB7 pixel ${t[0].toFixed(1)}, ${t[1].toFixed(1)}`:""}`,Tt("button",{textContent:"look from here",onclick:()=>{a(),r(e)}}),Tt("button",{textContent:"close",onclick:a})),l),i.hidden=!1,a}async function Fg(i,e,t){let n=[i,e].map(u=>u.sigma.point??0),{distance:r,sigma:s,level:o,height:a}=await Ho(`apart?at=${[...i.local,...e.local]}&sigma=${n}`),l=u=>ko(u,t.unit),c=s===null?"":` \xB1 ${l(s)}`;return`distance ${l(r)}${c} \xB7 level ${l(o)} \xB7 height difference ${l(a)}`}var Dg=async i=>{let e=await fetch(i);if(!e.ok)throw new Error((await e.json()).error);return new Float32Array(await e.arrayBuffer())};async function Lg(i,e){let[t,n]=await Promise.all([Dg(`mesh?k=${i}`),new Po().loadAsync(`picture?k=${i}`)]),[r,s]=t,o=t.subarray(2),a=[],l=[],c=g=>Number.isFinite(o[3*g]);for(let g=0;g<r;g++)for(let M=0;M<s;M++){let S=g*s+M,_=S+1,m=S+s,b=m+1;a.push((M+.5)/s,1-(g+.5)/r),!(g+1===r||M+1===s)&&c(_)&&c(m)&&(c(S)&&l.push(S,m,_),c(b)&&l.push(_,m,b))}let u=new Et;u.setAttribute("position",new ni(o.map(g=>Number.isFinite(g)?g:0),3)),u.setAttribute("uv",new Ft(a,2)),u.setIndex(l);let h=new Rr({map:n,alphaTest:.5,side:wi,clippingPlanes:e,polygonOffset:!0,polygonOffsetFactor:1,polygonOffsetUnits:1}),d=new oi(u,h);return d.frustumCulled=!1,d}async function Ug(i){let e=await Dg("contours"),t=[];for(let r=0;r+5<e.length;r+=3)Number.isFinite(e[r])&&Number.isFinite(e[r+3])&&t.push(...e.subarray(r,r+6));let n=new Et;return n.setAttribute("position",new Ft(t,3)),new Hn(n,new $i({color:"#e8c9a0",clippingPlanes:i}))}var Rv=4,gu=8,wv=.012,ht=i=>document.getElementById(i),Or=i=>new I(...i),Vo=i=>{ht("said").textContent=i.message??i,ht("said").hidden=!1};je.enabled=!1;Cv().catch(Vo);async function Cv(){let i=await Ho("layers.json");document.title=`${i.name}: tiegraph`,ht("name").textContent=i.name,ht("about").textContent=`${i.points.toLocaleString("en")} points, ${i.cameras.length} images, ${i.crs??"no CRS"}`;let e=[1,-1].flatMap(s=>[0,1,2].map(o=>new si(new I().setComponent(o,s),1/0))),t=new _u(ht("view"),e),n=new Wl("cloud.copc.laz",i.middle,e,s=>{s&&Vo(s),t.draw()});await n.open(),n.look("colour");let r=new El(i.cameras);Object.assign(t,{cloud:n,cameras:r}),t.home(),Pv(i,t,n,r,e),Fv(i,t,n),Dv(i,t,n,e),ht("compass").hidden=!i.crs,ht("home").onclick=()=>t.home(),ht("top").onclick=()=>t.top(),Lv(i,t,n,r,e),t.draw()}var _u=class{constructor(e,t){this.canvas=e,this.renderer=new No({canvas:e,antialias:!0,logarithmicDepthBuffer:!1}),this.renderer.outputColorSpace=On,this.renderer.localClippingEnabled=!0,this.renderer.setPixelRatio(Math.min(window.devicePixelRatio,2)),this.renderer.setClearColor("#1b2027"),this.scene=new To,this.camera=new li(50,1,.1,1e3),this.camera.up.set(0,0,1),this.controls=new Sl(this.camera,e),this.controls.zoomToCursor=!0,this.controls.addEventListener("change",()=>this.draw()),this.marks=new vi,this.scene.add(this.marks),new ResizeObserver(()=>this.draw()).observe(e)}draw(){this.asked||(this.asked=requestAnimationFrame(()=>{this.asked=null,this.show()}))}show(){if(!this.cloud)return;let{clientWidth:e,clientHeight:t}=this.canvas;this.size={x:e,y:t},this.renderer.setSize(e,t,!1);let n=Math.max(this.camera.position.distanceTo(this.controls.target),1e-6*this.radius);Object.assign(this.camera,{aspect:e/t,near:n/200,far:n*20+20*this.radius}),this.camera.updateProjectionMatrix(),this.camera.updateMatrixWorld(),this.cameras.fit(wv*n);let r=this.cloud.update(this.camera,t);this.renderer.render(this.scene,this.camera),ht("count").textContent=`${this.cloud.shown.toLocaleString("en")} points shown${r?"":" \u2026"}`,ht("north").style.transform=`rotate(${this.controls.getAzimuthalAngle()}rad)`,document.body.dataset.state=r?"whole":"loading"}look(e,t){this.camera.position.copy(e),this.controls.target.copy(t),this.controls.update(),this.draw()}whole(){let e=this.cloud.most.clone();this.cameras.cameras.forEach(({at:n})=>e.expandByPoint(Or(n)));let t=e.getSize(new I);return this.radius=Math.max(t.length()/2,1e-6),{centre:e.getCenter(new I),size:t}}home(){let{centre:e,size:t}=this.whole(),n=Or(t.x>=t.y?[.35,-1,.75]:[1,-.35,.75]).normalize();this.look(e.clone().addScaledVector(n,1.9*this.radius),e)}top(){let{centre:e}=this.whole();this.look(e.clone().add(new I(0,-.001,2.2).multiplyScalar(this.radius)),e)}mark(e,t){this.marks.clear();let n=new Et().setFromPoints(e.map(s=>Or(s.local))),r={color:"#ff3b6b",depthTest:!1};this.marks.add(new Lr(n,new Dr({...r,size:9*this.renderer.getPixelRatio(),sizeAttenuation:!1}))),t&&this.marks.add(new Fr(n,new $i(r))),this.marks.children.forEach(s=>{s.renderOrder=1,s.frustumCulled=!1}),this.draw()}};function Ig(i,e,t){let n=Tt("input",{type:"checkbox",checked:e,onchange:()=>t(n.checked)});return Tt("label",{},n,` ${i}`)}function Pv(i,e,t,n,r){let s=(a,l,c)=>{l.visible=c,e.scene.add(l),ht("layers").append(Ig(a,c,u=>{l.visible=u,e.draw()}))},o=(a,l)=>{let c=null;ht("layers").append(Ig(a,!1,async u=>{c||e.scene.add((c=new vi).add(await l().catch(h=>(Vo(h),new vi)))),c.visible=u,e.draw()}))};s("point cloud",t.group,!0),s("cameras",n.group,!0),s("tie graph",Am(i.cameras,i.ties),!1),i.sheets.forEach((a,l)=>o(a,()=>Lg(l,r))),i.contours&&o("contour lines",()=>Ug(r))}function Fv(i,e,t){let n={height:i.unit,sigma:i.unit,images:"images"};ht("ramp").style.background=`linear-gradient(to right, ${As.join(",")})`,mu.forEach(r=>ht("look").append(Tt("option",{textContent:r}))),ht("look").onchange=()=>{let r=ht("look").value,s=t.ranges[r];if(t.look(r),ht("legend").hidden=!s,s){let o=r==="height"?s.map(a=>a+i.middle[2]):s;ht("ends").replaceChildren(...o.map(a=>Tt("span",{textContent:r==="images"?a:ko(a,n[r],2)})))}e.draw()},ht("size").oninput=()=>{t.material.uniforms.size.value=Number(ht("size").value),e.draw()}}function Dv(i,e,t,n){Xl(i).forEach((r,s)=>{let o=t.low[s],a=t.high[s],l=Tt("span"),c=[0,1].map(h=>Tt("input",{type:"range",min:0,max:1e3,value:1e3*h,ariaLabel:`${r}, ${h?"highest":"lowest"}`})),u=()=>{let[h,d]=c.map(g=>o+g.value/1e3*(a-o));n[s].constant=c[0].value>0?-h:1/0,n[s+3].constant=c[1].value<1e3?d:1/0,l.textContent=`${(h+i.middle[s]).toFixed(2)} to ${(d+i.middle[s]).toFixed(2)}`,e.draw()};c.forEach(h=>{h.oninput=u}),u(),ht("clips").append(Tt("div",{},Tt("b",{textContent:r})," ",l,...c))}),ht("unclip").onclick=()=>ht("clips").querySelectorAll("input").forEach((r,s)=>{r.value=1e3*(s%2),r.oninput()})}function Lv(i,e,t,n,r){let s=[],o=null,a=()=>{},l=(...S)=>r.every(_=>_.distanceToPoint(Or(S))>=0),c=S=>{let _=e.canvas.getBoundingClientRect();return[S.clientX-_.left,S.clientY-_.top]},u=S=>{let{at:_,corners:m}=i.cameras[S],b=m.reduce((w,R)=>w.add(Or(R)),new I).normalize();e.look(Or(_),Or(_).addScaledVector(b,.3*e.radius))},h=(S,_)=>{a=Pg(ht("image"),S,_,i,u),n.choose(S),e.draw()},d=async S=>{let _=await Ho(`pick?at=${S}`),m=ht("measure").checked&&s.length>0;s=m?[s.at(-1),_]:[_],ht("distance").textContent=m?await Fg(...s,i):"",ht("place").replaceChildren(...wg(_,i,h)),ht("picked").hidden=!1,history.replaceState(null,"",`#${_.xyz.map(b=>b.toFixed(3)).join(",")}`),e.mark(s,m)},g=([S,_])=>{let m=n.group.visible?n.pick(S,_,e.camera,e.size,gu):null,b=t.group.visible?t.pick(S,_,e.camera,e.size,gu,l):null;return{camera:m,point:b}};e.canvas.addEventListener("pointerdown",S=>{o=c(S)}),e.canvas.addEventListener("pointerup",S=>{let[_,m]=c(S);if(S.button||!o||Math.hypot(_-o[0],m-o[1])>Rv)return;let{camera:b,point:w}=g([_,m]);b&&!(w&&w.depth<b.depth)?h(b.number,null):w&&d(w.at).catch(Vo)}),e.canvas.addEventListener("pointermove",S=>{let[_,m]=c(S),b=S.buttons||!e.size||!n.group.visible?null:n.pick(_,m,e.camera,e.size,gu);ht("tip").hidden=!b,b&&(ht("tip").textContent=i.cameras[b.number].name,Object.assign(ht("tip").style,{left:`${_+14}px`,top:`${m+10}px`}))}),window.addEventListener("keydown",S=>{S.key==="Escape"&&a()}),ht("unpick").onclick=()=>{s=[],ht("picked").hidden=!0,e.mark(s,!1)};let M=location.hash.slice(1).split(",").map(Number);M.length===3&&M.every(Number.isFinite)&&d(M.map((S,_)=>S-i.middle[_])).catch(Vo)}})();
