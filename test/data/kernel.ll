define internal void @body(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %v1 = load double, ptr %q, align 8
  %v2 = call double @llvm.fma.f64(double %v1, double 0x3FE45F306DC9C883, double 0x4338000000000000)
  %v3 = fsub double %v2, 0x4338000000000000
  %v4 = getelementptr double, ptr %q, i64 1
  %v5 = load double, ptr %v4, align 8
  %v6 = fsub double 0xC004000000000000, %v5
  %v7 = fneg double %v3
  %v8 = call double @llvm.fma.f64(double %v7, double 0x3FF921FB54440000, double %v1)
  %v9 = fneg double %v5
  %v10 = call double @llvm.fma.f64(double %v9, double %v6, double 0x3FF9000000000000)
  %v11 = fadd double %v3, 0x3FF0000000000000
  %v12 = fadd double %v3, 0x4348000000000000
  %v13 = call double @llvm.fma.f64(double %v7, double 0x3D868C234C4C0000, double %v8)
  %v14 = fsub double %v12, 0x4348000000000000
  %v15 = fadd double 0x4004000000000000, %v10
  %v16 = fsub double %v13, %v8
  %v17 = fmul double %v13, 0x3FE0000000000000
  %v18 = fsub double %v14, %v3
  %v19 = fmul double %v17, %v13
  %v20 = call double @llvm.fma.f64(double %v3, double 0x3D868C234C4C0000, double %v16)
  %v21 = call double @llvm.fma.f64(double %v3, double 0x3B298A2E03707345, double %v20)
  %v22 = fneg double %v19
  %v23 = call double @llvm.fma.f64(double %v22, double 0x3E45D8B559CDAE9C, double 0x3EAAE5E4B83F3EFB)
  %v24 = call double @llvm.fma.f64(double %v22, double 0x3E18FA684A042C88, double 0x3E81EE9DBCF1CA8B)
  %v25 = fdiv double 0x3FF0000000000000, %v15
  %v26 = call double @llvm.fma.f64(double %v23, double %v19, double 0xBF071DE35552B59E)
  %v27 = call double @llvm.fma.f64(double %v24, double %v19, double 0xBEE27E4F7F19164F)
  %v28 = fmul double %v13, %v19
  %v29 = call double @llvm.fma.f64(double %v26, double %v19, double 0x3F5A01A019BE9217)
  %v30 = call double @llvm.fma.f64(double %v27, double %v19, double 0x3F3A01A019C8F255)
  %v31 = fadd double %v11, 0x4348000000000000
  %v32 = call double @llvm.fma.f64(double %v29, double %v19, double 0xBFA111111110F730)
  %v33 = call double @llvm.fma.f64(double %v30, double %v19, double 0xBF86C16C16C15015)
  %v34 = fsub double %v31, 0x4348000000000000
  %v35 = fsub double %v11, %v34
  %v36 = call double @llvm.fma.f64(double %v32, double %v19, double 0x3FD5555555555548)
  %v37 = call double @llvm.fma.f64(double %v28, double %v36, double %v21)
  %v38 = call double @llvm.fma.f64(double %v33, double %v19, double 0x3FC555555555554B)
  %v39 = fsub double %v13, %v37
  %v40 = fmul double %v19, %v38
  %v41 = call double @llvm.fma.f64(double %v22, double %v40, double %v19)
  %v42 = load double, ptr %free, align 8
  %v43 = fcmp ogt double %v42, 0x0000000000000000
  %v44 = select i1 %v43, double %v25, double 0x0000000000000000
  %v45 = fmul double %v39, %v18
  %v46 = fmul double %v39, %v35
  %v47 = fsub double 0x3FF0000000000000, %v41
  %v48 = call double @llvm.fma.f64(double %v47, double %v35, double %v45)
  %v49 = fneg double %v47
  %v50 = call double @llvm.fma.f64(double %v49, double %v18, double %v46)
  %v51 = load double, ptr %qd, align 8
  %v52 = getelementptr double, ptr %qd, i64 1
  %v53 = load double, ptr %v52, align 8
  %v54 = fmul double %v51, %v53
  %v55 = fmul double %v51, %v51
  %v56 = fmul double %v48, 0x4020000000000000
  %v57 = getelementptr double, ptr %free, i64 1
  %v58 = load double, ptr %v57, align 8
  %v59 = fcmp ogt double %v58, 0x0000000000000000
  %v60 = select i1 %v59, double 0x3FF0000000000000, double 0x0000000000000000
  %v61 = fmul double %v55, %v5
  %v62 = fneg double %v50
  %v63 = call double @llvm.fma.f64(double %v62, double 0x4020000000000000, double %v61)
  %v64 = call double @llvm.fma.f64(double 0x4000000000000000, double %v54, double %v56)
  %v65 = call double @llvm.fma.f64(double %v55, double 0x3FF4000000000000, double %v63)
  %v66 = fmul double %v5, %v64
  %v67 = call double @llvm.fma.f64(double 0x3FF4000000000000, double %v64, double %v66)
  %v68 = getelementptr double, ptr %tau, i64 1
  %v69 = load double, ptr %v68, align 8
  %v70 = fadd double %v69, %v65
  %v71 = fadd double %v56, %v67
  %v72 = fmul double %v70, %v60
  %v73 = load double, ptr %tau, align 8
  %v74 = fsub double %v73, %v71
  %v75 = fcmp ogt double %v58, 0x0000000000000000
  %v76 = select i1 %v75, double %v72, double 0x0000000000000000
  %v77 = fmul double %v74, %v44
  %v78 = fcmp ogt double %v42, 0x0000000000000000
  %v79 = select i1 %v78, double %v77, double 0x0000000000000000
  store double %v79, ptr %out, align 8
  %v80 = getelementptr double, ptr %out, i64 1
  store double %v76, ptr %v80, align 8
  ret void
}

define void @evaluate(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %a1 = alloca [2 x double], align 64
  %v2 = load double, ptr %q, align 8
  %v3 = call double @llvm.fma.f64(double %v2, double %v2, double 0x0000000000000000)
  %v4 = fcmp ugt double %v3, 0x4202A05F20000000
  br i1 %v4, label %then5, label %after6, !prof !0
then5:
  %v7 = load double, ptr %q, align 8
  store double %v7, ptr %a1, align 8
  call void @wrap_row(ptr %a1)
  %v8 = getelementptr double, ptr %q, i64 1
  %v9 = load double, ptr %v8, align 8
  %v10 = getelementptr double, ptr %a1, i64 1
  store double %v9, ptr %v10, align 8
  br label %after6
after6:
  %v11 = phi ptr [ %a1, %then5 ], [ %q, %entry ]
  call void @body(ptr %v11, ptr %qd, ptr %tau, ptr %free, ptr %out)
  ret void
}

define internal void @wrap_row(ptr %row) cold noinline {
entry:
  br label %loop1
loop1:
  %v2 = phi i64 [ 0, %entry ], [ %v10, %after8 ]
  %v3 = getelementptr double, ptr %row, i64 %v2
  %v4 = load double, ptr %v3
  %v5 = call double @llvm.fabs.f64(double %v4)
  %v6 = fcmp ogt double %v5, 0x40F86A0000000000
  br i1 %v6, label %then7, label %after8
then7:
  %v9 = call double @wrap_angle(double %v4)
  store double %v9, ptr %v3
  br label %after8
after8:
  %v10 = add i64 %v2, 1
  %v11 = icmp ult i64 %v10, 1
  br i1 %v11, label %loop1, label %done12
done12:
  ret void
}

define internal ptr @one(ptr %args, i64 %count) {
entry:
  %v1 = icmp eq i64 %count, 5
  %v2 = xor i1 %v1, true
  br i1 %v2, label %then3, label %after4
then3:
  ret ptr null
after4:
  %v5 = getelementptr ptr, ptr %args, i64 0
  %v6 = load ptr, ptr %v5
  %v7 = getelementptr i8, ptr %v6, i64 8
  %v8 = load ptr, ptr %v7
  %v9 = icmp eq ptr %v8, @pfd.ndarray
  %v10 = xor i1 %v9, true
  br i1 %v10, label %then11, label %after12
then11:
  ret ptr null
after12:
  %v13 = getelementptr i8, ptr %v6, i64 56
  %v14 = load ptr, ptr %v13
  %v15 = icmp eq ptr %v14, @pfd.float64
  %v16 = xor i1 %v15, true
  br i1 %v16, label %then17, label %after18
then17:
  ret ptr null
after18:
  %v19 = getelementptr i8, ptr %v6, i64 24
  %v20 = load i32, ptr %v19
  %v21 = icmp eq i32 %v20, 1
  %v22 = xor i1 %v21, true
  br i1 %v22, label %then23, label %after24
then23:
  ret ptr null
after24:
  %v25 = getelementptr i8, ptr %v6, i64 64
  %v26 = load i32, ptr %v25
  %v27 = and i32 %v26, 256
  %v28 = icmp eq i32 %v27, 256
  %v29 = xor i1 %v28, true
  br i1 %v29, label %then30, label %after31
then30:
  ret ptr null
after31:
  %v32 = getelementptr ptr, ptr %args, i64 1
  %v33 = load ptr, ptr %v32
  %v34 = getelementptr i8, ptr %v33, i64 8
  %v35 = load ptr, ptr %v34
  %v36 = icmp eq ptr %v35, @pfd.ndarray
  %v37 = xor i1 %v36, true
  br i1 %v37, label %then38, label %after39
then38:
  ret ptr null
after39:
  %v40 = getelementptr i8, ptr %v33, i64 56
  %v41 = load ptr, ptr %v40
  %v42 = icmp eq ptr %v41, @pfd.float64
  %v43 = xor i1 %v42, true
  br i1 %v43, label %then44, label %after45
then44:
  ret ptr null
after45:
  %v46 = getelementptr i8, ptr %v33, i64 24
  %v47 = load i32, ptr %v46
  %v48 = icmp eq i32 %v47, 1
  %v49 = xor i1 %v48, true
  br i1 %v49, label %then50, label %after51
then50:
  ret ptr null
after51:
  %v52 = getelementptr i8, ptr %v33, i64 64
  %v53 = load i32, ptr %v52
  %v54 = and i32 %v53, 256
  %v55 = icmp eq i32 %v54, 256
  %v56 = xor i1 %v55, true
  br i1 %v56, label %then57, label %after58
then57:
  ret ptr null
after58:
  %v59 = getelementptr ptr, ptr %args, i64 2
  %v60 = load ptr, ptr %v59
  %v61 = getelementptr i8, ptr %v60, i64 8
  %v62 = load ptr, ptr %v61
  %v63 = icmp eq ptr %v62, @pfd.ndarray
  %v64 = xor i1 %v63, true
  br i1 %v64, label %then65, label %after66
then65:
  ret ptr null
after66:
  %v67 = getelementptr i8, ptr %v60, i64 56
  %v68 = load ptr, ptr %v67
  %v69 = icmp eq ptr %v68, @pfd.float64
  %v70 = xor i1 %v69, true
  br i1 %v70, label %then71, label %after72
then71:
  ret ptr null
after72:
  %v73 = getelementptr i8, ptr %v60, i64 24
  %v74 = load i32, ptr %v73
  %v75 = icmp eq i32 %v74, 1
  %v76 = xor i1 %v75, true
  br i1 %v76, label %then77, label %after78
then77:
  ret ptr null
after78:
  %v79 = getelementptr i8, ptr %v60, i64 64
  %v80 = load i32, ptr %v79
  %v81 = and i32 %v80, 256
  %v82 = icmp eq i32 %v81, 256
  %v83 = xor i1 %v82, true
  br i1 %v83, label %then84, label %after85
then84:
  ret ptr null
after85:
  %v86 = getelementptr ptr, ptr %args, i64 3
  %v87 = load ptr, ptr %v86
  %v88 = getelementptr i8, ptr %v87, i64 8
  %v89 = load ptr, ptr %v88
  %v90 = icmp eq ptr %v89, @pfd.ndarray
  %v91 = xor i1 %v90, true
  br i1 %v91, label %then92, label %after93
then92:
  ret ptr null
after93:
  %v94 = getelementptr i8, ptr %v87, i64 56
  %v95 = load ptr, ptr %v94
  %v96 = icmp eq ptr %v95, @pfd.float64
  %v97 = xor i1 %v96, true
  br i1 %v97, label %then98, label %after99
then98:
  ret ptr null
after99:
  %v100 = getelementptr i8, ptr %v87, i64 24
  %v101 = load i32, ptr %v100
  %v102 = icmp eq i32 %v101, 1
  %v103 = xor i1 %v102, true
  br i1 %v103, label %then104, label %after105
then104:
  ret ptr null
after105:
  %v106 = getelementptr i8, ptr %v87, i64 64
  %v107 = load i32, ptr %v106
  %v108 = and i32 %v107, 256
  %v109 = icmp eq i32 %v108, 256
  %v110 = xor i1 %v109, true
  br i1 %v110, label %then111, label %after112
then111:
  ret ptr null
after112:
  %v113 = getelementptr ptr, ptr %args, i64 4
  %v114 = load ptr, ptr %v113
  %v115 = getelementptr i8, ptr %v114, i64 8
  %v116 = load ptr, ptr %v115
  %v117 = icmp eq ptr %v116, @pfd.ndarray
  %v118 = xor i1 %v117, true
  br i1 %v118, label %then119, label %after120
then119:
  ret ptr null
after120:
  %v121 = getelementptr i8, ptr %v114, i64 56
  %v122 = load ptr, ptr %v121
  %v123 = icmp eq ptr %v122, @pfd.float64
  %v124 = xor i1 %v123, true
  br i1 %v124, label %then125, label %after126
then125:
  ret ptr null
after126:
  %v127 = getelementptr i8, ptr %v114, i64 24
  %v128 = load i32, ptr %v127
  %v129 = icmp eq i32 %v128, 1
  %v130 = xor i1 %v129, true
  br i1 %v130, label %then131, label %after132
then131:
  ret ptr null
after132:
  %v133 = getelementptr i8, ptr %v114, i64 64
  %v134 = load i32, ptr %v133
  %v135 = and i32 %v134, 1280
  %v136 = icmp eq i32 %v135, 1280
  %v137 = xor i1 %v136, true
  br i1 %v137, label %then138, label %after139
then138:
  ret ptr null
after139:
  %v140 = getelementptr i8, ptr %v6, i64 32
  %v141 = load ptr, ptr %v140
  %v142 = getelementptr i64, ptr %v141, i64 0
  %v143 = load i64, ptr %v142
  %v144 = getelementptr i8, ptr %v6, i64 40
  %v145 = load ptr, ptr %v144
  %v146 = getelementptr i64, ptr %v145, i64 0
  %v147 = load i64, ptr %v146
  %v148 = icmp eq i64 %v143, 2
  %v149 = icmp eq i64 %v147, 8
  %v150 = and i1 %v148, %v149
  %v151 = xor i1 %v150, true
  br i1 %v151, label %then152, label %after153
then152:
  ret ptr null
after153:
  %v154 = getelementptr i8, ptr %v6, i64 16
  %v155 = load ptr, ptr %v154
  %v156 = getelementptr double, ptr %v155, i64 0
  %v157 = getelementptr double, ptr %v155, i64 1
  %v158 = load double, ptr %v156
  %v159 = load double, ptr %v157
  %v160 = getelementptr i8, ptr %v33, i64 32
  %v161 = load ptr, ptr %v160
  %v162 = getelementptr i64, ptr %v161, i64 0
  %v163 = load i64, ptr %v162
  %v164 = getelementptr i8, ptr %v33, i64 40
  %v165 = load ptr, ptr %v164
  %v166 = getelementptr i64, ptr %v165, i64 0
  %v167 = load i64, ptr %v166
  %v168 = icmp eq i64 %v163, 2
  %v169 = icmp eq i64 %v167, 8
  %v170 = and i1 %v168, %v169
  %v171 = xor i1 %v170, true
  br i1 %v171, label %then172, label %after173
then172:
  ret ptr null
after173:
  %v174 = getelementptr i8, ptr %v33, i64 16
  %v175 = load ptr, ptr %v174
  %v176 = getelementptr double, ptr %v175, i64 0
  %v177 = getelementptr double, ptr %v175, i64 1
  %v178 = load double, ptr %v176
  %v179 = load double, ptr %v177
  %v180 = getelementptr i8, ptr %v60, i64 32
  %v181 = load ptr, ptr %v180
  %v182 = getelementptr i64, ptr %v181, i64 0
  %v183 = load i64, ptr %v182
  %v184 = getelementptr i8, ptr %v60, i64 40
  %v185 = load ptr, ptr %v184
  %v186 = getelementptr i64, ptr %v185, i64 0
  %v187 = load i64, ptr %v186
  %v188 = icmp eq i64 %v183, 2
  %v189 = icmp eq i64 %v187, 8
  %v190 = and i1 %v188, %v189
  %v191 = xor i1 %v190, true
  br i1 %v191, label %then192, label %after193
then192:
  ret ptr null
after193:
  %v194 = getelementptr i8, ptr %v60, i64 16
  %v195 = load ptr, ptr %v194
  %v196 = getelementptr double, ptr %v195, i64 0
  %v197 = getelementptr double, ptr %v195, i64 1
  %v198 = load double, ptr %v196
  %v199 = load double, ptr %v197
  %v200 = getelementptr i8, ptr %v87, i64 32
  %v201 = load ptr, ptr %v200
  %v202 = getelementptr i64, ptr %v201, i64 0
  %v203 = load i64, ptr %v202
  %v204 = getelementptr i8, ptr %v87, i64 40
  %v205 = load ptr, ptr %v204
  %v206 = getelementptr i64, ptr %v205, i64 0
  %v207 = load i64, ptr %v206
  %v208 = icmp eq i64 %v203, 2
  %v209 = icmp eq i64 %v207, 8
  %v210 = and i1 %v208, %v209
  %v211 = xor i1 %v210, true
  br i1 %v211, label %then212, label %after213
then212:
  ret ptr null
after213:
  %v214 = getelementptr i8, ptr %v87, i64 16
  %v215 = load ptr, ptr %v214
  %v216 = getelementptr double, ptr %v215, i64 0
  %v217 = getelementptr double, ptr %v215, i64 1
  %v218 = load double, ptr %v216
  %v219 = load double, ptr %v217
  %v220 = getelementptr i8, ptr %v114, i64 32
  %v221 = load ptr, ptr %v220
  %v222 = getelementptr i64, ptr %v221, i64 0
  %v223 = load i64, ptr %v222
  %v224 = getelementptr i8, ptr %v114, i64 40
  %v225 = load ptr, ptr %v224
  %v226 = getelementptr i64, ptr %v225, i64 0
  %v227 = load i64, ptr %v226
  %v228 = icmp eq i64 %v223, 2
  %v229 = icmp eq i64 %v227, 8
  %v230 = and i1 %v228, %v229
  %v231 = xor i1 %v230, true
  br i1 %v231, label %then232, label %after233
then232:
  ret ptr null
after233:
  %v234 = getelementptr i8, ptr %v114, i64 16
  %v235 = load ptr, ptr %v234
  %v236 = call double @llvm.fma.f64(double %v158, double 0x0000000000000000, double 0x0000000000000000)
  %v237 = call double @llvm.fma.f64(double %v159, double 0x0000000000000000, double 0x0000000000000000)
  %v238 = call double @llvm.fma.f64(double %v178, double 0x0000000000000000, double 0x0000000000000000)
  %v239 = call double @llvm.fma.f64(double %v179, double 0x0000000000000000, double 0x0000000000000000)
  %v240 = call double @llvm.fma.f64(double %v198, double 0x0000000000000000, double %v236)
  %v241 = call double @llvm.fma.f64(double %v199, double 0x0000000000000000, double %v237)
  %v242 = call double @llvm.fma.f64(double %v218, double 0x0000000000000000, double %v238)
  %v243 = call double @llvm.fma.f64(double %v219, double 0x0000000000000000, double %v239)
  %v244 = fadd double %v240, %v241
  %v245 = fadd double %v242, %v243
  %v246 = fadd double %v244, %v245
  %v247 = fcmp ord double %v246, %v246
  %v248 = xor i1 %v247, true
  br i1 %v248, label %then249, label %after250
then249:
  ret ptr null
after250:
  call void @evaluate(ptr %v155, ptr %v175, ptr %v195, ptr %v215, ptr %v235)
  ret ptr %v114
}

define ptr @entry(ptr %self, ptr %args, i64 %count) {
entry:
  %v1 = call ptr @one(ptr %args, i64 %count)
  %v2 = icmp eq ptr %v1, null
  br i1 %v2, label %then3, label %after4
then3:
  call void @pfd.incref(ptr @pfd.none)
  ret ptr @pfd.none
after4:
  call void @pfd.incref(ptr %v1)
  ret ptr %v1
}

define ptr @bound(ptr %self, ptr %args, i64 %count) {
entry:
  %v1 = call ptr @one(ptr %args, i64 %count)
  %v2 = icmp eq ptr %v1, null
  br i1 %v2, label %then3, label %after4
then3:
  call void @pfd.error(ptr @pfd.ValueError, ptr @message)
  ret ptr null
after4:
  call void @pfd.incref(ptr %v1)
  ret ptr %v1
}
